"""The options of a translation: the keyword arguments of :func:`prosim_scene.translate`."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

from .language.diagnostics import SceneError
from .language.words import PIXELS, Numbers, numbers_of

#: The plugins that the translation uses: those of this project, or only those of Mitsuba.
TARGETS = ("prosim", "stock")
#: The units of the Intensity of a light, which ``mitsuba.lights`` describes.
UNITS = ("calibrated", "radiance", "unattenuated")


@dataclass(frozen=True, kw_only=True)
class Options:
    """The options of a translation; :func:`prosim_scene.translate` describes them. Raises SceneError if an option has a
    wrong value.
    """

    target: str = "prosim"
    light_units: str = "calibrated"
    tolerance: float | None = None
    resolution: tuple[int, int] | None = None
    samples: int | None = None
    allow_outside: bool = False

    def __post_init__(self) -> None:
        samples, pixels = numbers_of("SETTING", "samples"), numbers_of("VIEW_PARAMETER", "resolution")
        self._check("target", self.target in TARGETS, f"one of {', '.join(TARGETS)}")
        self._check("light_units", self.light_units in UNITS, f"one of {', '.join(UNITS)}")
        self._check("tolerance", self.tolerance is None or _is_positive(self.tolerance), "a number of pixels above 0")
        allowed = self.samples is None or _are_allowed([self.samples], samples)
        self._check("samples", allowed, samples.range_in_words())
        allowed = self.resolution is None or _are_allowed(self.resolution, pixels)
        self._check("resolution", allowed, f"width and height, each {pixels.range_in_words()}, and {PIXELS} in all")

    def _check(self, name: str, allowed: bool, expected: str) -> None:
        if not allowed:
            raise SceneError(f"{name} is {getattr(self, name)!r}; expected {expected}")


def _is_positive(value: Any) -> bool:
    return isinstance(value, Real) and 0 < float(value) < math.inf


def _are_allowed(values: Any, allowed: Numbers) -> bool:
    numbers = list(values) if isinstance(values, Iterable) else []
    whole = len(numbers) == allowed.count and all(isinstance(number, Integral) for number in numbers)
    return whole and all(map(allowed.allows, numbers)) and math.prod(numbers) <= PIXELS
