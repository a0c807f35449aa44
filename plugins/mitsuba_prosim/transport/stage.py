"""The scene as trees and paths find it: what was asked for, and the facts about it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi

from .narrow import Narrow
from .ray import Ray
from .scene_facts import SceneFacts
from .settings import Settings

#: Radiance of the caustics at a surface: of the interaction, its BSDF, the number of the sample, and a mask.
Gather = Callable[[Any, Any, Any, Any], Any]


class Merging(Protocol):
    """Light that glossy surfaces get by way of smooth ones, from photons, as far as rays leave it to them."""

    #: Which glossy surfaces are nearly smooth.
    narrow: Narrow

    def __call__(self, ray: Ray, si: Any, bsdf: Any, drawn: Any, t: Any, active: Any) -> Any:
        """Radiance at a surface that ``ray`` has met, of the ``t``-th sample, by its glossy lobes, those ``drawn`` by a
        ray each.
        """

    def begun(self, si: Any, bsdf: Any, d: Any, pdf: Any) -> Any:
        """What a ray ``d`` of density ``pdf`` begins with, see :attr:`.Ray.begun`."""

    def density(self, it: Any, ds: Any, active: Any) -> Any:
        """How close together photons are on the ray of light that comes to ``it`` along ``ds`` from its source."""


#: Spaces of the sampling pattern that belong to the camera; those of the nodes follow.
PIXEL, LENS, TIME_AND_WAVELENGTH, CAMERA_SPACES = 0, 1, 2, 3

#: Spaces of a node, before those of the sources.
REFLECTED, REFRACTED, DIFFUSE, CHOICE, ROULETTE, NODE_SPACES = 0, 1, 2, 3, 4, 5


@dataclass(frozen=True)
class Stage:
    """``scene`` under ``settings``, and the ``facts`` about it.

    ``attached``: whether derivatives are wanted; directions are then fixed, or carried along with a source
    (:mod:`.moving`), and their weights evaluated anew. ``caustics``: the light that comes to diffuse surfaces by way
    of specular ones, where it is gathered from photons; None where it is left to the rays.
    """

    scene: mi.Scene
    settings: Settings
    facts: SceneFacts
    attached: bool = False
    #: The medium that the camera is in, or None.
    around: mi.Medium | None = None
    caustics: Gather | None = None
    #: Where glossy surfaces gather them too: what shares that light with the rays.
    merging: Merging | None = None

    def first(self, camera: mi.Ray3f) -> Ray:
        """The ray that begins with the ``mi.Ray3f`` of the camera."""
        ray = Ray.first(camera)
        if self.facts.indivisible or self.settings.diffuse_bounces > 0:
            ray.counts = mi.Bool(True)
        if self.facts.both_sides:
            ray.both_sides = mi.Bool(False)
        if self.facts.absorbs:
            ray.medium = mi.MediumPtr(self.around) if dr.is_jit_v(mi.Float) else self.around
            ray.gap = mi.Float(0)
        if self.merging is not None:
            ray.begun = ray.reach = mi.Float(0)
        if self.caustics is not None and self.facts.indivisible:
            ray.gathered = mi.Bool(False)
        if self.facts.lights.sampler is not None:
            ray.estimates = mi.Float(0)
        return ray

    def space(self, node: mi.UInt32, k: int | mi.UInt32) -> mi.UInt32:
        """Number of the ``k``-th space of a node."""
        return CAMERA_SPACES + node * (NODE_SPACES + self.facts.lights.count) + k
