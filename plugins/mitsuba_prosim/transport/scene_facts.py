"""What of a scene decides how its light is followed."""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi

from ..light.table import Lights
from . import lobes
from .absorption import absorbs_any
from .asking import any_careful, left_dim
from .dispersion import disperses
from .indivisible import any_indivisible
from .settings import Settings


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
    #: Whether any BSDF is taken whole, see :mod:`.indivisible`.
    indivisible: bool
    #: Whether any BSDF has to be asked for its lobes with care, see :mod:`.asking`.
    careful: bool
    #: Whether anything absorbs light on its way, see :mod:`.absorption`.
    absorbs: bool
    #: Whether any surface disperses, see :mod:`.dispersion`.
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
