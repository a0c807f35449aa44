"""The options of a translation, the keywords of :func:`prosim_scene.translate`."""

import math
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

from .language.diagnostics import SceneError
from .language.words import PIXELS, Numbers, numbers
from .mitsuba import TARGETS, lights


@dataclass(frozen=True, kw_only=True)
class Options:
    """The options of a translation, see :func:`translate`. Raises SceneError for a wrong value."""

    target: str = "prosim"
    light_units: str = "calibrated"
    tolerance: float | None = None
    resolution: tuple[int, int] | None = None
    samples: int | None = None
    allow_outside: bool = False

    def __post_init__(self) -> None:
        """Checks the values."""
        samples, pixels = numbers("SETTING", "samples"), numbers("VIEW_PARAMETER", "resolution")
        for name, allowed, expected in (
            ("target", self.target in list(TARGETS), f"one of {', '.join(TARGETS)}"),
            ("light_units", self.light_units in lights.UNITS, f"one of {', '.join(lights.UNITS)}"),
            ("tolerance", self.tolerance is None or _is_positive(self.tolerance), "a number of pixels above 0"),
            ("samples", self.samples is None or _whole(self.samples, samples), samples.bounds()),
            (
                "resolution",
                self.resolution is None or _is_size(self.resolution, pixels),
                f"width and height, each {pixels.bounds()}, and {PIXELS} in all",
            ),
        ):
            if not allowed:
                raise SceneError(f"{name} is {getattr(self, name)!r}; expected {expected}")


def _is_positive(value: Any) -> bool:
    return isinstance(value, Real) and 0 < float(value) < math.inf


def _is_size(size: Any, pixels: Numbers) -> bool:
    try:
        width, height = size
    except (TypeError, ValueError):
        return False
    return _whole(width, pixels) and _whole(height, pixels) and width * height <= PIXELS


def _whole(value: Any, takes: Numbers) -> bool:
    return isinstance(value, Integral) and takes.low <= int(value) <= takes.high
