"""What is said of Mitsuba's errors."""

import mitsuba as mi
import pytest
from mitsuba_prosim.scene_files import opening, session


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


@pytest.mark.parametrize("integrator, parallel", [("prosim", False), ("path", True)])
def test_scenes_with_plugins_in_python_are_not_made_in_parallel(
    variant_rgb, tmp_path, monkeypatch, integrator, parallel
):
    """Mitsuba 3.9 fails now and then if they are."""
    path = tmp_path / "scene.xml"
    path.write_text(f'<scene version="3.0.0"><integrator type="{integrator}"/></scene>')
    asked = []
    make = mi.parser.instantiate
    monkeypatch.setattr(
        mi.parser, "instantiate", lambda config, state: asked.append(config.parallel) or make(config, state)
    )
    opening.instantiate(opening.parse(path, {}))
    assert asked == [parallel]
