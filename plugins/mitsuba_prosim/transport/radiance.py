"""Image layers: additional images, each with the light of one light source, whose sum is the rendered image."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..compat import named_by

#: Allowed values of the parameter ``layers``.
KINDS = ("none", "lights")

#: Maximum number of layers.
MAX_LAYERS = 32


@dataclass
class Radiance:
    """Total radiance, and the part of it in each image layer; the list of parts is empty if the image has no layers."""

    total: mi.Spectrum
    layers: list[mi.Spectrum]

    def __add__(self, other: Radiance) -> Radiance:
        return Radiance(self.total + other.total, [a + b for a, b in zip(self.layers, other.layers)])

    def scaled(self, factor: mi.Spectrum) -> Radiance:
        """Returns this radiance times ``factor``."""
        return Radiance(factor * self.total, [factor * L for L in self.layers])

    def plus(self, value: mi.Spectrum, layer: int | mi.UInt32 | None) -> Radiance:
        """Returns this radiance with ``value`` added to the total, and to the layer number ``layer``."""
        return Radiance(self.total + value, [L + dr.select(layer == i, value, 0) for i, L in enumerate(self.layers)])


def layer_numbers(emitters: Sequence[mi.Emitter], constant: Sequence[str]) -> dict[str, int]:
    """Returns the name of each layer and its number: those of the ``emitters``, then the ``constant`` names, which are
    "background" and "ambient" if the image has these. Raises ValueError for more than :data:`MAX_LAYERS`.
    """
    names = [*light_names(emitters), *constant]
    if len(names) > MAX_LAYERS:
        raise ValueError(
            f'prosim: parameter "layers" is "lights", but {len(names)} layers are more than {MAX_LAYERS}; leave it out.'
        )
    return {name: number for number, name in enumerate(names)}


def light_names(emitters: Sequence[mi.Emitter]) -> list[str]:
    """Returns a unique name for the layer of each of the ``emitters``: the id of its shape, or of the emitter, with "_"
    for characters other than letters and digits, but not at the beginning; or a name such as ``lamp1``. A name that
    exists, such as "background" and "ambient", gets "_" at the end.
    """
    names = ["background", "ambient"]
    for number, emitter in enumerate(emitters, 1):
        name = re.sub(r"\W", "_", named_by(emitter).id() or "").lstrip("_") or f"lamp{number}"
        while name in names:
            name += "_"
        names.append(name)
    return names[2:]
