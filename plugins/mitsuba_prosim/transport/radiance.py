"""Layers: images of the parts of the light, written beside the image. The sum of all layers is the image.

``lights``
    one layer for each light source, one for the background, and one for the ambient term.
``levels``
    one layer for each level of the ray tree or path. The layer of level 0 has the light that the first visible surface
    emits, and the direct light that this surface scatters.
``terms``
    one layer for each term of the thesis's equation (section 4.1) at the first visible surface.

Light sampling at a vertex and the rays of its glossy lobes find the same light; MIS combines the two. Therefore the
light of a source that such a ray meets belongs to the layer of the vertex where the ray begins.
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

#: Allowed values of the parameter ``layers``.
KINDS = ("none", "lights", "levels", "terms")

#: Maximum number of layers.
MAX_LAYERS = 32

#: The number of a layer: an integer, or a Dr.Jit array.
Layer: TypeAlias = "int | mi.UInt32"


@dataclass
class Radiance:
    """Radiance, and the part of this radiance in each layer; the list of layers is empty unless layers are wanted."""

    total: mi.Spectrum
    layers: list[mi.Spectrum]

    def __add__(self, other: Radiance) -> Radiance:
        return Radiance(self.total + other.total, [a + b for a, b in zip(self.layers, other.layers)])

    def scaled(self, factor: mi.Spectrum) -> Radiance:
        """Returns this radiance and its layers, multiplied by ``factor``."""
        return Radiance(factor * self.total, [factor * L for L in self.layers])

    def plus(self, value: mi.Spectrum, layer: Layer, total: mi.Spectrum | None = None) -> Radiance:
        """Returns this radiance plus ``value``, where ``value`` belongs to ``layer``.

        ``total`` is the new total radiance, if the caller has computed the sum already.
        """
        layers = [L + dr.select(layer == i, value, 0) for i, L in enumerate(self.layers)]
        return Radiance(self.total + value if total is None else total, layers)

    def moved(self, value: mi.Spectrum, source: Layer, target: Layer) -> Radiance:
        """Returns this radiance after moving ``value`` from the layer ``source`` to the layer ``target``."""
        return self.plus(-value, source, self.total).plus(value, target, self.total)


class Layers:
    """Assigns light to layers. The base class assigns all light to no layer, for an image without layers."""

    #: Whether diffuse and glossy light belong to different layers.
    splits_lobes = False

    def __init__(self, names: Sequence[str] = ()) -> None:
        self.names = list(names)

    def none(self) -> Radiance:
        """Returns zero radiance, in all layers."""
        return Radiance(mi.Spectrum(0), [mi.Spectrum(0) for _ in self.names])

    def of(self, ray: Ray, term: str, source: Layer = 0) -> Layer:
        """Returns the number of the layer of a ``term`` of the light at the vertex that ``ray`` meets.

        The terms are "emitted", "background", "ambient", "diffuse", "glossy" and "caustics". ``source`` is the number
        of the light source from which the light comes.
        """
        return 0

    def branch(self, ray: Ray, diffuse: bool, through: mi.Bool) -> mi.UInt32:
        """Returns the :attr:`.Ray.branch` of the next ray: the layer of all light that this next ray finds.

        The next ray leaves the vertex at the end of ``ray`` through a diffuse lobe (``diffuse``) or a specular lobe.
        ``through`` tells whether the next ray passes through the surface.
        """
        return mi.UInt32(0)


class ByLight(Layers):
    """One layer for each light source, one for the background, and one for the ambient term."""

    def of(self, ray: Ray, term: str, source: Layer = 0) -> Layer:  # noqa: D102
        return self.names.index(term) if term in ("background", "ambient") else source


class ByLevel(Layers):
    """One layer for each level of the ray tree or path."""

    def of(self, ray: Ray, term: str, source: Layer = 0) -> Layer:  # noqa: D102
        # Emission that a ray from a surface meets is direct light of this surface.
        return dr.maximum(ray.level, 1) - 1 if term == "emitted" else ray.level


class ByTerm(Layers):
    """One layer for each term of the thesis's equation at the first visible surface."""

    splits_lobes = True

    def number(self, term: str) -> mi.UInt32:
        """Returns the number of the layer named ``term``."""
        return mi.UInt32(self.names.index(term))

    def of(self, ray: Ray, term: str, source: Layer = 0) -> Layer:  # noqa: D102
        beyond = ray.branch
        if term == "emitted":
            beyond = dr.select((ray.level == 1) & (ray.pdf > 0), self.number("glossy"), beyond)
        return dr.select(ray.level == 0, self.number(term), beyond)

    def branch(self, ray: Ray, diffuse: bool, through: mi.Bool) -> mi.UInt32:  # noqa: D102
        if diffuse:
            lobe = self.number("indirect")
        else:
            lobe = dr.select(through, self.number("refracted"), self.number("reflected"))
        return dr.select(ray.level == 0, lobe, ray.branch)


def layers_conflict(kind: str, settings: Settings, caustics: bool) -> str | None:
    """Tells whether ``layers=kind`` conflicts with another parameter of the integrator.

    Returns the advice to use instead, or None without a conflict.
    """
    if kind == "lights" and caustics:
        return "another value with caustics, as photons do not know their source"
    if kind == "levels" and not 0 <= settings.max_level < MAX_LAYERS:
        return f"another value, or max_level from 0 to {MAX_LAYERS - 1}"
    if kind == "terms" and settings.diffuse_bounces < 0:
        return "another value with diffuse_bounces -1, whose rays do not distinguish lobes"
    return None


def layers_of(kind: str, settings: Settings, lights: Lights, caustics: bool) -> Layers:
    """Returns the :class:`Layers` of this ``kind``, which is a value of the parameter ``layers``.

    Raises ValueError if ``kind`` is "lights" and there are more than 32 layers.
    """
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
    """Returns a unique name for each of the ``emitters``.

    The name of an emitter is the id of the emitter or of its shape. An emitter without an id is named by its number,
    such as ``lamp1``.
    """
    names = ["background", "ambient"]
    for number, emitter in enumerate(emitters, 1):
        shape = emitter.get_shape()
        name = re.sub(r"\W", "_", (emitter if shape is None else shape).id() or "").lstrip("_") or f"lamp{number}"
        while name in names:
            name += "_"
        names.append(name)
    return names[2:]
