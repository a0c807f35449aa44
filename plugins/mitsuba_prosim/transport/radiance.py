"""Layers: further images of the parts of the light, which add up to the image.

``lights``
    the light of each source, the background, and the ambient term.
``levels``
    the radiance of the vertices of each level of the ray tree (or path): 0 is the first visible surface with its direct
    light.
``terms``
    the terms of the thesis's equation (section 4.1) at the first visible surface.

Light that a ray of a glossy lobe finds at a source has an MIS partner, the light sampling at the vertex that the ray
leaves. So that light belongs to the layer of the vertex that the ray leaves, not of the source.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import drjit as dr
import mitsuba as mi

from ..light.table import Lights

if TYPE_CHECKING:
    from .ray import Ray
    from .transport_context import Settings

#: Values of the parameter ``layers``.
KINDS = ("none", "lights", "levels", "terms")

#: Greatest number of layers.
MAX_LAYERS = 32

#: The number of a layer: an integer, or a Dr.Jit array.
Layer: TypeAlias = "int | mi.UInt32"


@dataclass
class Radiance:
    """Radiance, and its part in each layer; no layers unless they are wanted."""

    total: mi.Spectrum
    layers: list[mi.Spectrum]

    def __add__(self, other: Radiance) -> Radiance:
        return Radiance(self.total + other.total, [a + b for a, b in zip(self.layers, other.layers)])

    def scaled(self, factor: mi.Spectrum) -> Radiance:
        """This radiance times ``factor``."""
        return Radiance(factor * self.total, [factor * L for L in self.layers])

    def plus(self, value: mi.Spectrum, layer: Layer, total: mi.Spectrum | None = None) -> Radiance:
        """This radiance and ``value``, which belongs to ``layer``. ``total``: their sum, if it is known."""
        layers = [L + dr.select(layer == i, value, 0) for i, L in enumerate(self.layers)]
        return Radiance(self.total + value if total is None else total, layers)

    def moved(self, value: mi.Spectrum, source: Layer, target: Layer) -> Radiance:
        """This radiance, with ``value`` moved from the layer ``source`` to the layer ``target``."""
        return self.plus(-value, source, self.total).plus(value, target, self.total)


class Layers:
    """Assigns light to layers; this class is that of an image without layers."""

    #: Whether light of different sources belongs to different layers.
    splits_sources = False
    #: Whether diffuse and glossy light belong to different layers, and light of different :attr:`.Ray.branch`.
    splits_lobes = False

    def __init__(self, names: Sequence[str] = ()) -> None:
        self.names = list(names)

    def none(self) -> Radiance:
        """No radiance."""
        return Radiance(mi.Spectrum(0), [mi.Spectrum(0) for _ in self.names])

    def of(self, ray: Ray, term: str, source: Layer = 0) -> Layer:
        """The layer of a ``term`` at the vertex that ``ray`` meets: "emitted", "background", "ambient", "diffuse",
        "glossy" or "caustics". ``source``: the number of the source that the light comes from.
        """
        return 0

    def branch(self, ray: Ray, diffuse: bool, through: mi.Bool) -> Layer:
        """:attr:`.Ray.branch` of a ray that leaves the vertex where ``ray`` ends, by a ``diffuse`` or another lobe,
        ``through`` the surface or not.
        """
        return 0


class ByLight(Layers):
    """A layer for each source, the background and the ambient term."""

    splits_sources = True

    def of(self, ray: Ray, term: str, source: Layer = 0) -> Layer:  # noqa: D102
        return self.names.index(term) if term in ("background", "ambient") else source


class ByLevel(Layers):
    """A layer for each level."""

    def of(self, ray: Ray, term: str, source: Layer = 0) -> Layer:  # noqa: D102
        return dr.maximum(ray.level, 1) - 1 if term == "emitted" else ray.level


class ByTerm(Layers):
    """A layer for each term of the equation at the first visible surface."""

    splits_lobes = True

    def number(self, term: str) -> mi.UInt32:
        """The number of the layer of this name."""
        return mi.UInt32(self.names.index(term))

    def of(self, ray: Ray, term: str, source: Layer = 0) -> Layer:  # noqa: D102
        beyond = ray.branch
        if term == "emitted":
            beyond = dr.select((ray.level == 1) & ray.uses_mis, self.number("glossy"), beyond)
        return dr.select(ray.level == 0, self.number(term), beyond)

    def branch(self, ray: Ray, diffuse: bool, through: mi.Bool) -> Layer:  # noqa: D102
        if diffuse:
            lobe = self.number("indirect")
        else:
            lobe = dr.select(through, self.number("refracted"), self.number("reflected"))
        return dr.select(ray.level == 0, lobe, ray.branch)


def layers_conflict(kind: str, settings: Settings, caustics: bool) -> str | None:
    """What to use instead where ``kind`` conflicts with another parameter; else None."""
    if kind == "lights" and caustics:
        return "another value with caustics, as photons do not know their source"
    if kind == "levels" and not 0 <= settings.max_level < MAX_LAYERS:
        return f"another value, or max_level from 0 to {MAX_LAYERS - 1}"
    if kind == "terms" and settings.diffuse_bounces < 0:
        return "another value with diffuse_bounces -1, whose rays do not distinguish lobes"
    return None


def layers_of(kind: str, settings: Settings, lights: Lights, caustics: bool) -> Layers:
    """The layers of this ``kind``. Raises ValueError where there are too many."""
    constant = ["background"] * (settings.background is not None) + ["ambient"] * (settings.ambient is not None)
    if kind == "levels":
        return ByLevel([f"level{level}" for level in range(settings.max_level + 1)])
    if kind == "terms":
        names = ["emitted", *constant, "diffuse", "glossy", *["caustics"] * caustics, "reflected", "refracted"]
        return ByTerm(names + ["indirect"] * (settings.diffuse_bounces > 0))
    if kind != "lights":
        return Layers()
    names = [*light_names(lights.emitters), *constant]
    if len(names) > MAX_LAYERS:
        raise ValueError(
            f'prosim: parameter "layers" is "lights", but {len(names)} layers are more than {MAX_LAYERS}; leave it out.'
        )
    return ByLight(names)


def light_names(emitters: Sequence[mi.Emitter]) -> list[str]:
    """Names of the ``emitters``: their ids, or those of their shapes; ``lamp1``, ``lamp2``, ... without an id."""
    names = ["background", "ambient"]
    for number, emitter in enumerate(emitters, 1):
        shape = emitter.get_shape()
        name = re.sub(r"\W", "_", (emitter if shape is None else shape).id() or "").lstrip("_") or f"lamp{number}"
        while name in names:
            name += "_"
        names.append(name)
    return names[2:]
