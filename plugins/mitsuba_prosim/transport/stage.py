"""The scene as trees and paths find it: what was asked for, and the facts about it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from .ray import Ray
from .scene_facts import SceneFacts
from .settings import Settings

#: Radiance of the caustics at a surface: of the interaction, its BSDF, the number of the sample, and a mask.
Gather = Callable[[Any, Any, Any, Any], Any]

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

    def first(self, camera: mi.Ray3f) -> Ray:
        """The ray that begins with the ``mi.Ray3f`` of the camera."""
        ray = Ray.first(camera)
        if self.facts.absorbs:
            ray.medium = mi.MediumPtr(self.around) if dr.is_jit_v(mi.Float) else self.around
            ray.gap = mi.Float(0)
        if self.caustics is not None and self.facts.indivisible:
            ray.gathered = mi.Bool(False)
        return ray

    def space(self, node: mi.UInt32, k: int | mi.UInt32) -> mi.UInt32:
        """Number of the ``k``-th space of a node."""
        return CAMERA_SPACES + node * (NODE_SPACES + self.facts.lights.count) + k
