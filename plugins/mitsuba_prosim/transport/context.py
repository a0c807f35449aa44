"""The context of trees and paths: settings, and facts about the scene that are gathered once a render."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi

from ..compat import INSTANCE
from ..light.table import Lights
from . import lobes
from .layers import layers_of
from .media import absorbs_any
from .ray import Ray
from .scattering import Scattering
from .workarounds import warn_of_dim_lobes

#: The nodes of a ray tree are numbered as in a heap, in 32 bits.
DEEPEST_TREE = 24

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


class PhotonMIS(Protocol):
    """Multiple importance sampling of rays and photons that find the same light, at glossy surfaces."""

    def first(self, ray: Any) -> Any:
        """The camera ray ``ray``, with the data for its MIS weights."""

    def next(self, vertex: Any, following: Any, bs: Any, weight: Any) -> Any:
        """The same for ``following``, which leaves ``vertex`` with the sample ``bs`` of this ``weight``."""

    def absorbed(self, ray: Any, transmitted: Any) -> Any:
        """The same for ``ray``, of whose light a medium has ``transmitted`` this part."""

    def emission_weight(self, ray: Any, origin: Any, ds: Any, pdf: Any, uses_mis: Any, weight: Any, active: Any) -> Any:
        """The MIS weight of emission that ``ray`` meets; ``weight`` where no photon could have found it.

        ``origin``, ``ds``: where the ray leaves, and the sample of the source there, which light sampling takes with
        the density ``pdf`` in the lanes ``uses_mis``.
        """

    def light_pdf(self, vertex: Any, active: Any) -> Any:
        """A function of a light sample at ``vertex``: the density of all other strategies that find its light."""


class PhotonMaps(Protocol):
    """Photons that surfaces gather."""

    #: The MIS of photons and rays; None where only diffuse surfaces gather.
    mis: PhotonMIS | None

    def add_to(self, L: Any, vertex: Any, drawn: Any, t: Any) -> Any:
        """``L`` plus the radiance of the photons at ``vertex``, for the ``t``-th sample of a pixel. ``drawn``: the
        glossy lobes, each with its own ray.
        """


class Context:
    """``scene`` under ``settings``.

    ``attached``: whether derivatives are wanted. Directions are then fixed, or move with a source
    (:mod:`..light.reparameterisation`), and their weights are evaluated again. ``around``: the medium that the camera
    is in, or None. ``photons``: find the light that reaches surfaces through specular ones; None if the rays find it.
    """

    def __init__(
        self,
        scene: mi.Scene,
        settings: Settings,
        attached: bool = False,
        around: mi.Medium | None = None,
        photons: PhotonMaps | None = None,
    ) -> None:
        warn_of_dim_lobes(scene)
        self.scene, self.settings, self.attached, self.around = scene, settings, attached, around
        self.photons = photons
        self.lights = Lights(scene, choose=not settings.follows_tree)
        #: To which layer light belongs.
        self.layers = layers_of(settings.layers, settings, self.lights, photons is not None)
        #: How BSDFs are sampled and evaluated.
        self.scattering = Scattering.of(scene, separate=settings.diffuse_bounces >= 0)
        #: Whether anything absorbs light on its way, see :mod:`.media`.
        self.absorbs = absorbs_any(scene, around)
        #: Union of the ``mi.BSDFFlags`` of all surfaces: whether any has a specular reflection, a specular
        #: transmission, smooth lobes lit from both sides.
        self.flags = scene_flags(scene)
        self.reflects, self.refracts, self.both_sides = (
            bool(lobes.has_any(self.flags, *names)) for names in (lobes.REFLECTED, lobes.REFRACTED, lobes.BOTH_SIDES)
        )
        #: Those of the lobes with a ray of their own that may be glossy.
        self.glossy: tuple[mi.BSDFContext, ...]
        if settings.diffuse_bounces < 0:
            self.glossy = (lobes.everything(),)
        elif settings.follows_tree:
            of_rays = zip(lobes.GLOSSY, (lobes.reflected(), lobes.refracted()))
            self.glossy = tuple(lobe for name, lobe in of_rays if lobes.has_any(self.flags, name))
        else:
            self.glossy = (lobes.specular(),) if lobes.has_any(self.flags, *lobes.GLOSSY) else ()
        #: The lobes lit by light sampling and by their own rays, with MIS; and those lit by light sampling alone, as no
        #: ray of theirs may meet a source, or None.
        self.mis_lobes = self.glossy if settings.diffuse_bounces < 0 or not self.lights.only_points else ()
        self.light_lobes = None
        if settings.diffuse_bounces >= 0:
            self.light_lobes = lobes.diffuse() if self.mis_lobes else lobes.everything()

    @property
    def photon_mis(self) -> PhotonMIS | None:
        """The MIS of photons and rays, or None."""
        return None if self.photons is None else self.photons.mis

    def first(self, camera: mi.Ray3f) -> Ray:
        """The ray that begins with the ``mi.Ray3f`` of the camera."""
        ray = Ray.first(camera)
        if self.scattering.any_inseparable or self.settings.diffuse_bounces > 0:
            ray.sees_emission = mi.Bool(True)
        if self.both_sides:
            ray.both_sides = mi.Bool(False)
        if self.absorbs:
            ray.medium = mi.MediumPtr(self.around) if dr.is_jit_v(mi.Float) else self.around
            ray.offset = mi.Float(0)
        if self.photons is not None and (self.scattering.any_inseparable or not self.settings.follows_tree):
            ray.gathered_photons = mi.Bool(False)
        if self.lights.sampler is not None:
            ray.importance = mi.Float(0)
        if self.layers.follows_branch:
            ray.branch = mi.UInt32(0)
        return ray if self.photon_mis is None else self.photon_mis.first(ray)

    def space(self, node: mi.UInt32, k: int | mi.UInt32) -> mi.UInt32:
        """Number of the ``k``-th space of a node."""
        return CAMERA_SPACES + node * (NODE_SPACES + self.lights.count) + k


def scene_flags(scene: mi.Scene) -> int:
    """Union of the ``mi.BSDFFlags`` of all surfaces of ``scene``; all flags where instances hide them."""
    flags = 0
    for shape in scene.shapes():
        bsdf = shape.bsdf()
        flags |= 0xFFFFFFFF if shape.class_name() == INSTANCE else 0 if bsdf is None else int(bsdf.m_flags)
    return flags
