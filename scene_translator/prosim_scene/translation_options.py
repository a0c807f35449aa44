"""The options of a translation: the keyword arguments of :func:`prosim_scene.translate`."""

import math
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

from .language.diagnostics import SceneError
from .language.words import PIXELS, Numbers, numbers_of
from .mitsuba import TARGETS, lights


@dataclass(frozen=True, kw_only=True)
class Options:
    """The options of a translation, which :func:`translate` describes. Raises SceneError for a wrong value."""

    target: str = "prosim"
    light_units: str = "calibrated"
    tolerance: float | None = None
    resolution: tuple[int, int] | None = None
    samples: int | None = None
    allow_outside: bool = False

    def __post_init__(self) -> None:
        """Checks the values of the options."""
        samples, pixels = numbers_of("SETTING", "samples"), numbers_of("VIEW_PARAMETER", "resolution")
        for name, allowed, expected in (
            ("target", self.target in list(TARGETS), f"one of {', '.join(TARGETS)}"),
            ("light_units", self.light_units in lights.UNITS, f"one of {', '.join(lights.UNITS)}"),
            ("tolerance", self.tolerance is None or _is_positive(self.tolerance), "a number of pixels above 0"),
            ("samples", self.samples is None or _is_whole(self.samples, samples), samples.range_in_words()),
            (
                "resolution",
                self.resolution is None or _is_size(self.resolution, pixels),
                f"width and height, each {pixels.range_in_words()}, and {PIXELS} in all",
            ),
        ):
            if not allowed:
                raise SceneError(f"{name} is {getattr(self, name)!r}; expected {expected}")


def _is_positive(value: Any) -> bool:
    """Whether a value is a finite number above 0."""
    return isinstance(value, Real) and 0 < float(value) < math.inf


def _is_size(size: Any, pixels: Numbers) -> bool:
    """Whether a value is an allowed image size (width, height); ``pixels`` describes the range of each number."""
    try:
        width, height = size
    except (TypeError, ValueError):
        return False
    return _is_whole(width, pixels) and _is_whole(height, pixels) and width * height <= PIXELS


def _is_whole(value: Any, allowed: Numbers) -> bool:
    """Whether a value is a whole number in a range."""
    return isinstance(value, Integral) and allowed.low <= int(value) <= allowed.high
