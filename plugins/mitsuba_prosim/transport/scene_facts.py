"""What of a scene decides how its light is followed."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..light.table import Lights
from . import lobes
from .ambient import hides_ambient, knows_ambient
from .indivisible import is_indivisible
from .settings import Settings


class Singled:
    """A BSDF of the scene that is treated apart; to be made outside of loops."""

    def __init__(self, bsdf: mi.BSDF):
        self.bsdf = bsdf
        if dr.is_jit_v(mi.Float):
            self._pointer = mi.BSDFPtr(bsdf)
            dr.make_opaque(self._pointer)  # else the kernel would depend on it

    def equals(self, bsdf):
        """Where ``bsdf`` (a ``mi.BSDFPtr``, or a BSDF in scalar variants) is this one."""
        return bsdf == self._pointer if dr.is_jit_v(mi.Float) else bsdf is self.bsdf


@dataclass(frozen=True)
class SceneFacts:
    """Facts about a scene, gathered once a render."""

    lights: Lights
    #: Whether any surface has a specular lobe of reflection, of transmission.
    reflects: bool
    refracts: bool
    #: Whether light from both of its sides reaches any surface's smooth lobes.
    both_sides: bool
    #: Whether every BSDF has the attribute ``ambient``, as far as is known; and those that hide one of a nested BSDF's.
    all_ambient: bool
    hidden_ambient: tuple[Singled, ...]
    #: BSDFs that are taken whole, see :mod:`.indivisible`.
    indivisible: tuple[Singled, ...]
    #: ``mi.BSDFContext`` of the lobes that the sources are sampled for alone, as no ray is drawn from them that may
    #: meet a source; or None.
    alone: mi.BSDFContext | None
    #: Those of the lobes that share the light of sources with the rays that are drawn from them.
    partners: tuple[mi.BSDFContext, ...]

    @classmethod
    def of(cls, scene: mi.Scene, settings: Settings) -> SceneFacts:
        """The facts of ``scene`` that matter under ``settings``."""
        bsdfs = list(dict.fromkeys(shape.bsdf() for shape in scene.shapes() if shape.bsdf() is not None))
        instances = any(shape.class_name() == "Instance" for shape in scene.shapes())

        def singled(kind):
            return tuple(Singled(bsdf) for bsdf in bsdfs if kind(bsdf))

        lights, flags = Lights(scene), scene_flags(scene)
        reflects = lobes.has_any(flags, *lobes.REFLECTED)
        refracts = lobes.has_any(flags, *lobes.REFRACTED)
        alone, partners = lobes.everything(), ()
        if settings.diffuse_bounces < 0:
            alone, partners = None, (lobes.everything(),)
        elif not lights.only_points and lobes.has_any(flags, "GlossyReflection", "GlossyTransmission"):
            alone = lobes.diffuse()
            if settings.follows_tree:
                partners = (lobes.reflected(),) * reflects + (lobes.refracted(),) * refracts
            else:
                partners = (lobes.specular(),)
        return cls(lights, reflects, refracts, lobes.has_any(flags, *lobes.BOTH_SIDES),
                   not instances and all(map(knows_ambient, bsdfs)), singled(hides_ambient),
                   singled(is_indivisible) if settings.diffuse_bounces >= 0 else (), alone, partners)

    def is_whole(self, bsdf):
        """Whether ``bsdf`` (a ``mi.BSDFPtr``, or a BSDF in scalar variants) is one that is taken whole: a mask or False."""
        whole = False
        for one in self.indivisible:
            whole = whole | one.equals(bsdf)
        return whole


def scene_flags(scene: mi.Scene) -> int:
    """Union of the ``mi.BSDFFlags`` of all surfaces of ``scene``; all flags where instances hide them."""
    flags = 0
    for shape in scene.shapes():
        bsdf = shape.bsdf()
        flags |= 0xFFFFFFFF if shape.class_name() == "Instance" else 0 if bsdf is None else int(bsdf.m_flags)
    return flags
