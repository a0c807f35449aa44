"""The context of trees and paths: the settings, and properties of the scene that are found once per render."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import mitsuba as mi

from ..light.table import Lights
from ..optics.nested import all_flags
from . import lobes
from .absorption import absorbs_any, pointer
from .radiance import layers_of
from .ray import Ray
from .scattering import Scattering
from .workarounds import warn_of_dim_lobes

#: The nodes of a ray tree are numbered as in a heap, in 32 bits.
DEEPEST_TREE = 24

#: Unlimited number of diffuse reflections of paths.
UNLIMITED = (1 << 31) - 1

#: Spaces of the sampling pattern that belong to the camera; those of the nodes follow.
PIXEL, LENS, TIME_AND_WAVELENGTH, CAMERA_SPACES = 0, 1, 2, 3

#: Spaces of a node, before those of the sources.
REFLECTED, REFRACTED, DIFFUSE, CHOICE, ROULETTE, NODE_SPACES = 0, 1, 2, 3, 4, 5


@dataclass(frozen=True)
class Settings:
    """Settings of the transport of light; :ref:`integrator-prosim` has their meaning."""

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
        """Whether light is followed along Whitted's tree, with no ray from a diffuse lobe, and not along paths."""
        return self.diffuse_bounces == 0


#: Names of the settings.
SETTINGS = tuple(field.name for field in fields(Settings))


class Context:
    """``scene`` under ``settings``.

    ``attached``: whether derivatives are wanted. Directions are then fixed, or move with a source
    (:mod:`..light.reparameterisation`), and their weights are evaluated again. ``camera_medium``: the medium around the
    camera, or None. ``caustics``: the photons (``photons.caustics.Caustics``) that find the light which reaches
    surfaces through specular ones; None if the rays find it.
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
            # A path must distinguish diffuse from other reflections, which a ray of the whole BRDF does not.
            settings = replace(settings, diffuse_bounces=UNLIMITED)
        warn_of_dim_lobes(scene)
        self.scene, self.settings, self.attached, self.camera_medium = scene, settings, attached, camera_medium
        #: The photons, which must have been emitted before samples are taken; and their MIS with rays, or None.
        self.caustics, self.photon_mis = caustics, None if caustics is None else caustics.mis
        self.lights = Lights(scene, choose=not settings.follows_tree)
        #: To which layer light belongs, whether there are any, and the names of their channels.
        self.layers = layers_of(settings.layers, settings, self.lights, caustics is not None)
        self.has_layers = bool(self.layers.names)
        self.aov_names = [f"{name}.{letter}" for name in self.layers.names for letter in "RGB"]
        #: How BSDFs are sampled and evaluated.
        self.scattering = Scattering.of(scene, separate=settings.diffuse_bounces >= 0)
        #: Whether anything absorbs light on its way, see :mod:`.absorption`.
        self.absorbs = absorbs_any(scene, camera_medium)
        #: Union of the ``mi.BSDFFlags`` of all surfaces: whether any has a specular reflection, a specular
        #: transmission, smooth lobes lit from both sides.
        self.flags = all_flags(scene)
        self.reflects, self.refracts, self.both_sides = (
            bool(lobes.has_any(self.flags, *names)) for names in (lobes.REFLECTED, lobes.REFRACTED, lobes.BOTH_SIDES)
        )
        #: The lobes lit by light sampling and by their own rays, with MIS ...
        self.mis_lobes: tuple[mi.BSDFContext, ...] = (lobes.all_lobes(),)
        #: ... and those lit by light sampling alone, as no ray of theirs may meet a source, or None.
        self.light_lobes: mi.BSDFContext | None = None
        if settings.diffuse_bounces >= 0:
            self.mis_lobes = () if self.lights.all_delta else lobes.glossy(self.flags, settings.follows_tree)
            self.light_lobes = lobes.diffuse() if self.mis_lobes else lobes.all_lobes()
        #: Whether one call of a BSDF evaluates a lobe for the only lamp and samples its ray, so that its textures are
        #: evaluated once.
        self.samples_with_light = (
            not attached
            and not (self.scattering.disperses or self.scattering.mixes or self.scattering.any_inseparable)
            and (self.lights.sampler is not None or self.lights.lamps == 1)
        )

    def first(self, camera: mi.Ray3f) -> Ray:
        """The ray that begins with the ``mi.Ray3f`` of the camera."""
        ray = Ray.first(camera)
        if self.scattering.any_inseparable or self.settings.diffuse_bounces > 0:
            ray.sees_emission = mi.Bool(True)
        if self.both_sides:
            ray.both_sides = mi.Bool(False)
        if self.absorbs:
            ray.medium, ray.offset = pointer(self.camera_medium), mi.Float(0)
        if self.caustics is not None and (self.scattering.any_inseparable or not self.settings.follows_tree):
            ray.gathered_photons = mi.Bool(False)
        if self.lights.sampler is not None:
            ray.importance = mi.Float(0)
        if self.layers.splits_lobes:
            ray.branch = mi.UInt32(0)
        return ray if self.photon_mis is None else self.photon_mis.first(ray)

    def space(self, node: mi.UInt32, k: int | mi.UInt32) -> mi.UInt32:
        """Number of the ``k``-th space of a node."""
        return CAMERA_SPACES + node * (NODE_SPACES + self.lights.count) + k


def direction_space(lobe: mi.BSDFContext) -> int:
    """The space of a node for the direction of the ray of ``lobe``."""
    if lobe.type_mask & lobes.mask(*lobes.DIFFUSE):
        return DIFFUSE
    return REFLECTED if lobe.type_mask & lobes.mask(*lobes.REFLECTED) else REFRACTED
