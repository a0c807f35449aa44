"""The options of a translation, which :func:`prosim_scene.translate` and others take as keywords."""

import math
from dataclasses import dataclass

from .language.diagnostics import SceneError
from .language.words import PIXELS, Numbers, numbers
from .targets import TARGETS, lights


@dataclass(frozen=True, kw_only=True)
class Options:
    """The options of a translation, those of :func:`translate`; SceneError for a value that is not allowed."""

    target: str = "prosim"
    light_units: str = "calibrated"
    tolerance: float | None = None
    resolution: tuple[int, int] | None = None
    samples: int | None = None
    allow_outside: bool = False

    def __post_init__(self) -> None:
        """Checks the values."""
        samples, pixels = numbers("SETTING", "samples"), numbers("VIEW_PARAMETER", "resolution")
        self._check("target", self.target in TARGETS, f"one of {', '.join(TARGETS)}")
        self._check("light_units", self.light_units in lights.UNITS, f"one of {', '.join(lights.UNITS)}")
        self._check("tolerance", self.tolerance is None or 0 < self.tolerance < math.inf, "a number of pixels above 0")
        self._check("samples", self.samples is None or _whole(self.samples, samples), samples.bounds())
        size = self.resolution
        self._check(
            "resolution",
            size is None or (len(size) == 2 and all(_whole(x, pixels) for x in size) and math.prod(size) <= PIXELS),
            f"width and height, each {pixels.bounds()}, and {PIXELS} in all",
        )

    def _check(self, name: str, allowed: bool, expected: str) -> None:
        if not allowed:
            raise SceneError(f"{name} is {getattr(self, name)!r}; expected {expected}")


def _whole(value: int, takes: Numbers) -> bool:
    return int(value) == value and takes.low <= value <= takes.high
