"""Fixtures of the plugins' tests."""

import mitsuba as mi
import pytest


@pytest.fixture
def logged(monkeypatch):
    """What is logged during the test by Python: pairs ``(level, text)``."""
    entries = []

    def log(level, text):
        entries.append((level, text))

    monkeypatch.setattr(mi, "Log", log)
    return entries
