"""The context of ray trees and paths: the settings of the integrator, and properties of the scene that rays need."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import drjit as dr
import mitsuba as mi

from ..light.emitter_methods import warn_of_unsampled, warn_of_wrong_light
from ..light.table import Lights
from ..optics.nested import all_flags
from ..sampling.spaces import CAMERA_SPACES, DIFFUSE, NODE_SPACES, REFLECTED, REFRACTED
from . import lobes
from .absorption import absorbs_any, pointer, warn_of_shadows
from .radiance import Radiance, layer_numbers
from .ray import Ray
from .scattering import Scattering
from .workarounds import repair_boxes, warn_of_blends_in_maps, warn_of_coarse_rays, warn_of_missing_flags


@dataclass(frozen=True)
class Settings:
    """Settings of the light transport; the plugin page :ref:`integrator-prosim` explains each setting."""

    max_level: int
    shadows: bool
    ambient: mi.Texture | None
    background: mi.Texture | None
    diffuse_bounces: int
    cutoff: float
    rr_depth: int
    rr_throughput: float
    hide_emitters: bool
    layers: str

    @property
    def follows_tree(self) -> bool:
        """Whether the integrator follows Whitted's ray tree, which has no diffuse rays, instead of paths."""
        return self.diffuse_bounces == 0


#: Names of the settings.
SETTINGS = tuple(field.name for field in fields(Settings))


#: Maximum level of a ray tree: its nodes are numbered as in a heap, in 32 bits.
DEEPEST_TREE = 24

#: Maximum number of diffuse reflections of a path that stands for no limit.
UNLIMITED_BOUNCES = (1 << 31) - 1


class Context:
    """The data that all ray trees or paths of one render share: the ``settings`` and properties of ``scene``.

    ``attached`` tells whether derivatives are wanted. ``camera_medium`` is the medium around the camera, or None.
    ``caustics`` (``photons.caustics.Caustics``) holds the photons; None without photons.
    """

    def __init__(
        self,
        settings: Settings,
        scene: mi.Scene,
        attached: bool = False,
        camera_medium: mi.Medium | None = None,
        caustics: Any | None = None,
    ) -> None:
        if caustics is not None and settings.diffuse_bounces < 0:
            # With photons, a path must distinguish diffuse from other reflections. A ray that samples the whole BRDF
            # cannot.
            settings = replace(settings, diffuse_bounces=UNLIMITED_BOUNCES)
        repair_boxes(scene)
        warn_of_wrong_light(scene.emitters())
        #: Gets the values of :meth:`observe`; None except in the explanation of a pixel.
        self.observer: Callable[..., None] | None = None
        self.scene, self.settings, self.attached = scene, settings, attached
        #: The photons, emitted by :meth:`.Caustics.use_pass`; and the MIS of photons and rays. Each may be None.
        self.caustics, self.photon_mis = caustics, None if caustics is None else caustics.mis
        self.lights = Lights(scene, choose=not settings.follows_tree)
        #: The number of each layer; whether there are layers; the channel names of the layers.
        constant = [name for name in ("background", "ambient") if getattr(settings, name) is not None]
        self.layers = {} if settings.layers == "none" else layer_numbers(self.lights.emitters, constant)
        self.has_layers = bool(self.layers)
        self.aov_names = [f"{name}.{letter}" for name in self.layers for letter in "RGB"]
        if settings.diffuse_bounces >= 0:
            warn_of_unsampled(self.lights.emitters)
        warn_of_missing_flags(scene)
        warn_of_coarse_rays(scene)
        warn_of_blends_in_maps(scene, mi.BSDFContext() if settings.diffuse_bounces < 0 else lobes.only(lobes.SPECULAR))
        #: Samples and evaluates BSDFs.
        paths = settings.diffuse_bounces < 0
        self.scattering = Scattering(scene, separate=not paths, whole=paths, attached=attached)
        #: The medium around the camera; None also if no medium of the scene absorbs light (:mod:`.absorption`).
        self.medium = None
        if absorbs_any(scene, camera_medium):
            self.medium = pointer(camera_medium)
            delta = [e for e in self.lights.emitters if mi.has_flag(e.flags(), mi.EmitterFlags.Delta)]
            warn_of_shadows(scene, self.lights.emitters if settings.follows_tree else delta)
        #: Union of the ``mi.BSDFFlags`` of all surfaces; whether any surface has a specular reflection, a specular
        #: transmission, or smooth lobes that are lit from both sides.
        self.flags = all_flags(scene)
        self.reflects, self.refracts, self.both_sides = (
            bool(lobes.has_any(self.flags, *names)) for names in (lobes.REFLECTED, lobes.REFRACTED, lobes.BOTH_SIDES)
        )
        #: Whether camera rays that leave the scene see the sky or the background.
        hidden = settings.hide_emitters or scene.environment() is None
        self.shows_sky = settings.background is not None or not hidden
        #: Whether it matters that some surfaces let camera rays pass straight through.
        self.sees_through = bool(lobes.has_any(self.flags, "Null")) and (settings.hide_emitters or not self.shows_sky)
        #: The lobes whose light comes from light sampling and from their own rays, combined by MIS.
        self.mis_lobes: lobes.Lobes = (mi.BSDFContext(),)
        #: The lobes whose light comes from light sampling alone, because emission at the end of their rays does not
        #: count, or because no ray can hit a light source. None if there are no such lobes.
        self.light_lobes: mi.BSDFContext | None = None
        if settings.diffuse_bounces >= 0:
            self.mis_lobes = () if self.lights.all_delta else lobes.glossy(self.flags, settings.follows_tree)
            self.light_lobes = lobes.only(lobes.DIFFUSE) if self.mis_lobes else mi.BSDFContext()
        #: Whether one call of a BSDF evaluates a lobe for the sampled lamp and samples the next ray of this lobe, so
        #: that textures are evaluated once.
        self.samples_with_light = (
            not attached
            and not (self.scattering.disperses or self.scattering.needs_workarounds)
            and (self.lights.sampler is not None or self.lights.lamps == 1)
        )

    def no_light(self) -> Radiance:
        """Returns zero radiance, in all layers."""
        return Radiance(mi.Spectrum(0), [mi.Spectrum(0) for _ in self.layers])

    def observe(self, event: str, ray: Ray, **values: Any) -> None:
        """Passes the ``values`` of the computation ``event`` at the end of ``ray`` to the :attr:`observer`. Within a
        loop, they are variables of the kernel.
        """
        if self.observer is not None:
            self.observer(event, ray, **values)

    def first(self, camera: mi.Ray3f) -> Ray:
        """Returns ``camera`` as the first :class:`.Ray`; unneeded fields are None, its normal has no meaning."""
        node, level, pdf, n = mi.UInt32(1), mi.UInt32(0), mi.Float(0), mi.Normal3f(camera.d)
        # An opaque value: Dr.Jit would trace a loop twice to find that a literal value stays the same.
        offset, found = mi.Float(0), dr.opaque(mi.Bool, False)
        ray = Ray(camera.o, camera.d, mi.Spectrum(1), node, level, pdf, n, self.medium, offset, found)
        ray.both_sides = mi.Bool(False) if self.both_sides else None
        ray.passed = mi.Bool(True) if self.sees_through else None
        ray.importance = None if self.lights.sampler is None else mi.Float(0)
        ray.etendue = None if self.photon_mis is None else mi.Float(0)
        return ray

    def space(self, node: mi.UInt32, k: int | mi.UInt32) -> mi.UInt32:
        """Returns the ``k``-th space, a pair of random numbers, of the node number ``node``."""
        return CAMERA_SPACES + node * (NODE_SPACES + self.lights.count) + k


def direction_space(lobe: mi.BSDFContext) -> int:
    """Returns the space that samples the direction of a node's ray through ``lobe``."""
    if lobe.type_mask & lobes.mask(*lobes.DIFFUSE):
        return DIFFUSE
    return REFLECTED if lobe.type_mask & lobes.mask(*lobes.REFLECTED) else REFRACTED
