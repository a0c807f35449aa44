"""Image layers: additional images, each with a part of the light of the rendered image, which is their sum.

The page of the integrator explains the parameter ``layers``. Light sampling at a vertex, and rays from its glossy
lobes, find the light of the same sources, and MIS combines the two estimates. So the light of a source that a ray from
a glossy lobe meets belongs to the layer of the vertex where the ray begins.
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
    from .settings import Settings

#: Allowed values of the parameter ``layers``.
KINDS = ("none", "lights", "levels", "terms")

#: Maximum number of layers.
MAX_LAYERS = 32

#: The number of a layer: an integer, or a Dr.Jit array.
Layer: TypeAlias = "int | mi.UInt32"


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

    def plus(self, value: mi.Spectrum, layer: Layer, total: mi.Spectrum | None = None) -> Radiance:
        """Returns this radiance with ``value`` added to the layer number ``layer``, and to the total unless the new
        ``total`` is given.
        """
        layers = [L + dr.select(layer == i, value, 0) for i, L in enumerate(self.layers)]
        return Radiance(self.total + value if total is None else total, layers)


class Layers:
    """Assigns light to image layers; the base class is for an image without layers."""

    #: Whether diffuse and glossy light belong to different layers.
    splits_lobes = False

    def __init__(self, names: Sequence[str] = ()) -> None:
        self.names = list(names)

    def none(self) -> Radiance:
        """Returns zero radiance, in all layers."""
        return Radiance(mi.Spectrum(0), [mi.Spectrum(0) for _ in self.names])

    def of(self, ray: Ray, term: str, source: Layer = 0) -> Layer:
        """Returns the number of the layer for the light ``term`` at the end of ``ray`` ("emitted", "background",
        "ambient", "diffuse", "glossy" or "caustics") from the light source number ``source``.
        """
        return 0

    def branch(self, ray: Ray, diffuse: bool, through: mi.Bool) -> mi.UInt32:
        """Returns the attribute :attr:`.Ray.branch` of the ray that leaves the end of ``ray`` through a diffuse or a
        specular lobe, perhaps ``through`` the surface.
        """
        return mi.UInt32(0)


class ByLight(Layers):
    """Layers by light source, with one for the background and one for the ambient term."""

    def of(self, ray: Ray, term: str, source: Layer = 0) -> Layer:  # noqa: D102
        return self.names.index(term) if term in ("background", "ambient") else source


class ByLevel(Layers):
    """Layers by level: one for each number of reflections and refractions on the way from the camera."""

    def of(self, ray: Ray, term: str, source: Layer = 0) -> Layer:
        """Returns the level of ``ray``; for emission that it meets, that of the surface where it begins."""
        return dr.maximum(ray.level, 1) - 1 if term == "emitted" else ray.level


class ByTerm(Layers):
    """Layers by term: one for each term of the thesis's equation for reflected light at the first visible surface."""

    splits_lobes = True

    def number(self, term: str) -> mi.UInt32:
        """Returns the number of the layer named ``term``."""
        return mi.UInt32(self.names.index(term))

    def of(self, ray: Ray, term: str, source: Layer = 0) -> Layer:
        """Returns the layer ``term`` for a camera ray, else ``ray.branch``; "glossy" for emission that a ray from a
        glossy lobe of the first vertex meets.
        """
        beyond = ray.branch
        if term == "emitted":
            beyond = dr.select((ray.level == 1) & (ray.pdf > 0), self.number("glossy"), beyond)
        return dr.select(ray.level == 0, self.number(term), beyond)

    def branch(self, ray: Ray, diffuse: bool, through: mi.Bool) -> mi.UInt32:
        """Returns the layer "indirect", "refracted" or "reflected" at the first vertex, else ``ray.branch``."""
        if diffuse:
            lobe = self.number("indirect")
        else:
            lobe = dr.select(through, self.number("refracted"), self.number("reflected"))
        return dr.select(ray.level == 0, lobe, ray.branch)


def layers_conflict(kind: str, settings: Settings, caustics: bool) -> str | None:
    """Returns the argument ``allowed`` of :func:`.parameters.reject` if the value ``kind`` of the parameter ``layers``
    conflicts with another parameter, else None.
    """
    if kind == "lights" and caustics:
        return "another value with caustics, as photons do not know their source"
    if kind == "levels" and not 0 <= settings.max_level < MAX_LAYERS:
        return f"another value, or max_level from 0 to {MAX_LAYERS - 1}"
    if kind == "terms" and settings.diffuse_bounces < 0:
        return "another value with diffuse_bounces -1, whose rays do not distinguish lobes"
    return None


def layers_of(kind: str, settings: Settings, lights: Lights, caustics: bool) -> Layers:
    """Returns the :class:`Layers` for the value ``kind`` of the parameter ``layers``. Raises ValueError for more than
    :data:`MAX_LAYERS`.
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
    """Returns a unique name for the layer of each of the ``emitters``: the id of its shape, or of the emitter, with "_"
    for characters other than letters and digits, but not at the beginning; or a name such as ``lamp1``. A name that
    exists, such as "background" and "ambient", gets "_" at the end.
    """
    names = ["background", "ambient"]
    for number, emitter in enumerate(emitters, 1):
        shape = emitter.get_shape()
        name = re.sub(r"\W", "_", (emitter if shape is None else shape).id() or "").lstrip("_") or f"lamp{number}"
        while name in names:
            name += "_"
        names.append(name)
    return names[2:]
