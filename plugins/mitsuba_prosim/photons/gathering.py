"""Gathering: the radiance of the photons around a point of a diffuse surface."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..compat import BLEND, DIFFUSE, INSTANCE, MASK, TWO_SIDED
from ..optics.nested import all_bsdfs, all_within
from ..transport import lobes
from ..transport.ray import Vertex
from ..transport.scattering import Scattering
from .grid import Photons, gather

#: Class names of BSDFs whose diffuse lobe is Lambert's, ours and Mitsuba's, and of those around others that change
#: nothing in it.
LAMBERTIAN = ("Lambertian", "Phong", "Composite", *DIFFUSE)
AROUND = (TWO_SIDED, MASK, BLEND)


class Gathering:
    """The diffuse lobes of the surfaces of ``scene``, lit by photons."""

    def __init__(self, scene: mi.Scene) -> None:
        self.scattering = Scattering.of(scene)
        #: Whether all diffuse lobes are Lambert's.
        self.lambertian = (
            not any(s.class_name() == INSTANCE for s in scene.shapes())
            and not self.scattering.any_inseparable
            and all(map(is_lambertian, all_bsdfs(scene)))
        )

    def __call__(self, photons: Photons, number: mi.UInt32, vertex: Vertex) -> mi.Spectrum:
        """Radiance of the photons of the map ``number`` by the diffuse lobes at ``vertex``; by all lobes if they are
        inseparable.
        """
        si, bsdf, inseparable = vertex.si, vertex.bsdf, vertex.inseparable
        active = vertex.active & (lobes.has_any(bsdf.flags(), *lobes.DIFFUSE) | inseparable)

        def light(i: mi.UInt32, in_reach: mi.Bool) -> mi.Spectrum:
            wo = -dr.gather(mi.Vector3f, photons.landed.d, i, in_reach)
            flux = dr.gather(mi.Spectrum, photons.landed.flux, i, in_reach)
            cos = dr.dot(si.sh_frame.n, wo)
            if self.lambertian:
                in_reach = in_reach & (cos * si.wi.z > 0)
                return dr.select(in_reach, flux, 0)
            in_reach = in_reach & (dr.abs(cos) > 1e-6)
            wo = si.to_local(wo)
            f = bsdf.eval(lobes.diffuse(), si, wo, in_reach)
            f = self.scattering.or_all_lobes(f, vertex, wo, in_reach)
            return dr.select(in_reach, f * flux / dr.select(in_reach, dr.abs(cos), 1), 0)

        L = gather(photons, number, si, light, active)
        if self.lambertian:
            lit = active & (dr.max(L) > 0)
            L *= bsdf.eval(lobes.diffuse(), si, mi.Vector3f(0, 0, dr.sign(si.wi.z)), lit)
        return L


def is_lambertian(bsdf: mi.BSDF) -> bool:
    """Whether all diffuse lobes of ``bsdf`` reflect alike in every direction."""
    return all(
        one.class_name() in AROUND
        or {one.class_name(), type(one).__name__} & set(LAMBERTIAN)
        or not lobes.has_any(int(one.flags()), *lobes.DIFFUSE)
        for one in all_within(bsdf)
    )
