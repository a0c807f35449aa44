"""The scene as trees and paths find it: what was asked for, and the facts about it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi

from ..light.table import Lights
from . import lobes
from .media import absorbs_any
from .ray import Ray
from .scattering import Scattering
from .workarounds import warn_of_dim_lobes

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
    #: How its BSDFs are sampled and evaluated.
    scattering: Scattering
    #: Whether anything absorbs light on its way, see :mod:`.media`.
    absorbs: bool
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
        warn_of_dim_lobes(scene)
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
            Scattering.of(scene, separate=settings.diffuse_bounces >= 0),
            absorbs_any(scene, around),
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


class PhotonMIS(Protocol):
    """Multiple importance sampling of rays and photons that find the same light, at glossy surfaces."""

    def first(self) -> Any:
        """The state of a camera ray: :attr:`.Ray.etendue`."""

    def next(self, vertex: Any, following: Any, bs: Any, weight: Any, whole: Any) -> Any:
        """The state of the ray ``following``, which leaves ``vertex`` with the sample ``bs`` of this ``weight``.

        ``whole``: the lanes of BSDFs without separable lobes, where photons have no part.
        """

    def emission_weight(self, ray: Any, origin: Any, ds: Any, pdf: Any, shares: Any, weight: Any, active: Any) -> Any:
        """The MIS weight of emission that ``ray`` meets; ``weight`` where no photon could have found it.

        ``origin``, ``ds``: where the ray leaves, and the sample of the source there, which has the density ``pdf``
        where it ``shares`` the light.
        """

    def light_pdf(self, ray: Any, si: Any, bsdf: Any, active: Any) -> Any:
        """A function of a sample of a source at ``si``: the density of all other strategies that find its light."""


class PhotonMaps(Protocol):
    """Photons that surfaces gather."""

    #: What shares light between photons and rays; None where only diffuse surfaces gather.
    mis: PhotonMIS | None

    def add_to(self, L: Any, ray: Any, si: Any, bsdf: Any, drawn: Any, t: Any, active: Any, scattered: Any) -> Any:
        """``L`` plus the radiance of the photons at ``si``, which ``ray`` meets, for the ``t``-th sample of a pixel.

        ``drawn``: the glossy lobes, each with a ray of its own. ``scattered``: the lanes behind a diffuse reflection,
        whose glossy lobes gather none.
        """


#: Spaces of the sampling pattern that belong to the camera; those of the nodes follow.
PIXEL, LENS, TIME_AND_WAVELENGTH, CAMERA_SPACES = 0, 1, 2, 3

#: Spaces of a node, before those of the sources.
REFLECTED, REFRACTED, DIFFUSE, CHOICE, ROULETTE, NODE_SPACES = 0, 1, 2, 3, 4, 5


@dataclass(frozen=True)
class Context:
    """``scene`` under ``settings``, and the ``facts`` about it.

    ``attached``: whether derivatives are wanted. Directions are then fixed, or move with a source
    (:mod:`.reparameterised`), and their weights are evaluated again. ``photons``: find the light that reaches
    surfaces through specular ones; None if the rays find it.
    """

    scene: mi.Scene
    settings: Settings
    facts: SceneFacts
    attached: bool = False
    #: The medium that the camera is in, or None.
    around: mi.Medium | None = None
    photons: PhotonMaps | None = None

    @property
    def photon_mis(self) -> PhotonMIS | None:
        """What shares light between photons and rays, or None."""
        return None if self.photons is None else self.photons.mis

    def first(self, camera: mi.Ray3f) -> Ray:
        """The ray that begins with the ``mi.Ray3f`` of the camera."""
        ray = Ray.first(camera)
        if self.facts.scattering.inseparable or self.settings.diffuse_bounces > 0:
            ray.counts = mi.Bool(True)
        if self.facts.both_sides:
            ray.both_sides = mi.Bool(False)
        if self.facts.absorbs:
            ray.medium = mi.MediumPtr(self.around) if dr.is_jit_v(mi.Float) else self.around
            ray.gap = mi.Float(0)
        if self.photon_mis is not None:
            ray.etendue = self.photon_mis.first()
        if self.photons is not None and self.facts.scattering.inseparable:
            ray.gathered = mi.Bool(False)
        if self.facts.lights.sampler is not None:
            ray.estimates = mi.Float(0)
        return ray

    def space(self, node: mi.UInt32, k: int | mi.UInt32) -> mi.UInt32:
        """Number of the ``k``-th space of a node."""
        return CAMERA_SPACES + node * (NODE_SPACES + self.facts.lights.count) + k
