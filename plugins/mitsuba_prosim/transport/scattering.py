"""Samples of glass that disperses, for who knows what a ray carries (Thomas 1986)."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..optics.nested import all_shapes
from ..sampling import wavelengths
from ..sampling.hash import combine
from ..sampling.nrook import SamplerPoints
from ..sampling.sobol import Points
from . import workarounds


def disperses(scene: mi.Scene) -> bool:
    """Whether any surface of ``scene`` refracts each wavelength its own way, as far as it says so itself."""
    return any(getattr(shape.bsdf(), "disperses", False) for shape in all_shapes(scene))


def evenly(points: Points, space: mi.UInt32, choice: mi.Float) -> mi.Float:
    """``choice``, a number in [0, 1) by which glass chooses what a ray keeps, such that the samples of a pixel together
    divide the spectrum evenly.
    """
    if not mi.is_spectral or isinstance(points, SamplerPoints):
        return choice
    return wavelengths.kept(combine(points.key, space), *points.division, choice)


def sample(
    lobe: mi.BSDFContext,
    si: mi.SurfaceInteraction3f,
    bsdf: mi.BSDF | mi.BSDFPtr,
    choice: mi.Float,
    point: mi.Point2f,
    throughput: mi.Spectrum | None,
    active: mi.Bool,
) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
    """Samples the ``lobe`` of ``bsdf`` like :func:`.workarounds.sample`.

    Dispersive, ideally smooth glass refracts one wavelength. It chooses among those that the ray still carries, by its
    ``throughput``. Without a throughput (None) all wavelengths go the same way.
    """
    weights = None
    if throughput is not None:
        carried = [dr.maximum(t, 0) for t in dr.detach(mi.unpolarized_spectrum(throughput))]
        total = sum(carried, mi.Float(0))
        weights = [dr.select(total > 0, t / dr.select(total > 0, total, 1), 1 / len(carried)) for t in carried]

    # Dr.Jit traces it once for each kind of BSDF, and wants what it computes with as arguments.
    def sampled(
        one: mi.BSDF,
        si: mi.SurfaceInteraction3f,
        choice: mi.Float,
        point: mi.Point2f,
        weights: list[mi.Float] | None,
        active: mi.Bool,
    ) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
        if getattr(one, "disperses", False):
            return one.sample_carried(lobe, si, choice, point, weights, active)
        return workarounds.sample(lobe, si, one, choice, point, active)

    if not dr.is_jit_v(mi.Float):
        return sampled(bsdf, si, choice, point, weights, active)
    return dr.dispatch(bsdf, sampled, si, choice, point, weights, active)
