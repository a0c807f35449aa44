"""The scene as trees and paths find it: what was asked for, and the facts about it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi

from ..light.table import Lights
from . import lobes
from .media import absorbs_any
from .narrow import Narrow
from .ray import Ray
from .scattering import disperses
from .workarounds import any_careful, any_indivisible, left_dim

#: The nodes of a ray tree are numbered as in a heap, in 32 bits.
DEEPEST_TREE = 24


@dataclass(frozen=True)
class Settings:
    """Settings of the transport of light; :ref:`integrator-prosim` says what each means."""

    max_level: int
    shadows: bool
    ambient: mi.Texture | None
    background: mi.Texture | None
    diffuse_bounces: int
    cutoff: float
    rr_depth: int
    rr_throughput: float
    hide_emitters: bool

    @property
    def follows_tree(self) -> bool:
        """Whether light is followed as Whitted's tree, with nothing from a diffuse component, not along paths."""
        return self.diffuse_bounces == 0


@dataclass(frozen=True)
class SceneFacts:
    """Facts about a scene, gathered once a render."""

    lights: Lights
    #: Whether there is any surface: without one Dr.Jit has no BSDF to dispatch to.
    surfaces: bool
    #: Whether any surface has a specular lobe of reflection, of transmission.
    reflects: bool
    refracts: bool
    #: Whether any surface has a lobe of one direction: a mirror, ideal glass, what passes straight through.
    ideal: bool
    #: Whether light from both of its sides reaches any surface's smooth lobes.
    both_sides: bool
    #: Whether any BSDF is taken whole, see :mod:`.workarounds`.
    indivisible: bool
    #: Whether any BSDF has to be asked for its lobes with care, see :mod:`.workarounds`.
    careful: bool
    #: Whether anything absorbs light on its way, see :mod:`.media`.
    absorbs: bool
    #: Whether any surface disperses, see :mod:`.scattering`.
    disperses: bool
    #: ``mi.BSDFContext`` of the lobes that the sources are sampled for alone, as no ray is drawn from them that may
    #: meet a source; or None.
    alone: mi.BSDFContext | None
    #: Those of the lobes that share the light of sources with the rays that are drawn from them.
    partners: tuple[mi.BSDFContext, ...]
    #: Those of the lobes with a ray of their own that may be glossy.
    glossy: tuple[mi.BSDFContext, ...]

    @classmethod
    def of(cls, scene: mi.Scene, settings: Settings, around: mi.Medium | None = None) -> SceneFacts:
        """The facts of ``scene`` that matter under ``settings``; ``around``: the medium that the camera is in."""
        left_dim(scene)
        lights, flags = Lights(scene, choose=not settings.follows_tree), scene_flags(scene)
        reflects = lobes.has_any(flags, *lobes.REFLECTED)
        refracts = lobes.has_any(flags, *lobes.REFRACTED)
        alone: mi.BSDFContext | None = lobes.everything()
        partners: tuple[mi.BSDFContext, ...] = ()
        if settings.diffuse_bounces < 0:
            alone, partners = None, (lobes.everything(),)
        elif not lights.only_points and lobes.has_any(flags, "GlossyReflection", "GlossyTransmission"):
            alone = lobes.diffuse()
            if settings.follows_tree:
                partners = (lobes.reflected(),) * reflects + (lobes.refracted(),) * refracts
            else:
                partners = (lobes.specular(),)
        if settings.follows_tree:
            reflected, refracted = (lobes.has_any(flags, name) for name in lobes.GLOSSY)
            glossy = (lobes.reflected(),) * reflected + (lobes.refracted(),) * refracted
        else:
            glossy = (lobes.specular(),)
        return cls(
            lights,
            bool(scene.shapes()),
            reflects,
            refracts,
            lobes.has_any(flags, "DeltaReflection", "DeltaTransmission", "Null"),
            lobes.has_any(flags, *lobes.BOTH_SIDES),
            settings.diffuse_bounces >= 0 and any_indivisible(scene),
            any_careful(scene),
            absorbs_any(scene, around),
            disperses(scene),
            alone,
            partners,
            glossy,
        )


def scene_flags(scene: mi.Scene) -> int:
    """Union of the ``mi.BSDFFlags`` of all surfaces of ``scene``; all flags where instances hide them."""
    flags = 0
    for shape in scene.shapes():
        bsdf = shape.bsdf()
        flags |= 0xFFFFFFFF if shape.class_name() == "Instance" else 0 if bsdf is None else int(bsdf.m_flags)
    return flags


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

    ``attached``: whether derivatives are wanted. Directions are then fixed, or move with a source
    (:mod:`.reparameterised`), and their weights are evaluated again. ``caustics``: gathers the light that reaches
    diffuse surfaces through specular ones from photons; None if the rays find that light.
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
