"""What is said of Mitsuba's errors."""

import mitsuba as mi
import pytest
from mitsuba_prosim.scene_files import session


def test_message_without_a_traceback_and_with_its_cause():
    cause = RuntimeError(
        "could not load:\nTraceback (most recent call last):\n  File a, line 1\nValueError: it is wrong"
    )
    error = RuntimeError("dr.while_loop(): encountered an exception (see above).")
    error.__cause__ = cause
    assert (
        session.message(error) == "dr.while_loop(): encountered an exception (see above). could not load:\nit is wrong"
    )


def test_a_variant_without_its_backend(monkeypatch):
    before = mi.variant()
    monkeypatch.setattr(session, "has_backend", lambda variant: variant.startswith("scalar"))
    with pytest.raises(RuntimeError, match="cuda_ad_rgb needs an NVIDIA GPU"):
        session.set_variant("cuda_ad_rgb")
    assert mi.variant() == before and session.default_variant() == "scalar_rgb"
