"""Lobes of BSDFs sampled and evaluated, with the workarounds that a scene needs and with dispersion (Thomas 1986)."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..masks import idle
from ..optics.nested import all_shapes
from ..sampling import wavelengths
from ..sampling.hash import combine
from ..sampling.nrook import SamplerPoints
from ..sampling.sobol import Points
from . import lobes, workarounds


def disperses(scene: mi.Scene) -> bool:
    """Whether any BSDF of ``scene`` declares that it refracts each wavelength in another direction."""
    return any(getattr(shape.bsdf(), "disperses", False) for shape in all_shapes(scene))


@dataclass(frozen=True)
class Scattering:
    """Samples and evaluates lobes of the BSDFs of a scene."""

    #: Whether any BSDF disperses.
    disperses: bool
    #: Whether any BSDF needs the workarounds for ``mask`` or ``blendbsdf``.
    mixes: bool
    #: Whether any BSDF has no separable lobes, so that it is evaluated as a whole.
    inseparable: bool

    @classmethod
    def of(cls, scene: mi.Scene, separate: bool = True) -> Scattering:
        """The BSDFs of ``scene``. ``separate``: whether lobes are evaluated separately at all."""
        inseparable = separate and workarounds.any_inseparable(scene)
        return cls(disperses(scene), workarounds.any_mixed(scene), inseparable)

    def whole(self, bsdf: mi.BSDF | mi.BSDFPtr, active: mi.Bool) -> mi.Bool:
        """The active lanes whose BSDF has no separable lobes."""
        return active & workarounds.without_separable_lobes(bsdf, active) if self.inseparable else mi.Bool(False)

    def sample(
        self,
        lobe: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        bsdf: mi.BSDF | mi.BSDFPtr,
        choice: mi.Float,
        point: mi.Point2f,
        throughput: mi.Spectrum | None,
        active: mi.Bool,
        whole: mi.Bool | None = None,
    ) -> tuple[mi.BSDFSample3f, mi.Spectrum, mi.Bool]:
        """``(bs, weight, belongs)``: a sample of ``lobe``, and whether it is one of that lobe.

        ``choice``: a number in [0, 1) that chooses among lobes. ``throughput``: what the ray carries, for dispersion,
        or None. In the lanes ``whole`` all lobes are sampled, and each sample belongs to one of the lobes that are
        followed separately.
        """
        if self.disperses or self.mixes:
            carried = throughput if self.disperses else None
            bs, weight = sample_carried(lobe, si, bsdf, choice, point, carried, active)
        else:
            bs, weight = bsdf.sample(lobe, si, choice, point, active)
        # thindielectric samples lobes that it is not asked for: these are sampled in their own turn.
        belongs = (bs.sampled_type & lobe.type_mask) != 0
        if not self.inseparable or whole is None or idle(active & whole):
            return bs, weight, belongs
        every = lobes.everything(lobe.mode)
        bs_all, weight_all = workarounds.sample_all(every, si, bsdf, choice, point, active & whole, self.mixes)
        belongs_all = workarounds.belongs_to(lobe, si.wi, bs_all)
        return tuple(dr.select(whole, a, b) for a, b in ((bs_all, bs), (weight_all, weight), (belongs_all, belongs)))

    def eval_pdf(
        self,
        lobe: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        bsdf: mi.BSDF | mi.BSDFPtr,
        wo: mi.Vector3f,
        active: mi.Bool,
        whole: mi.Bool | None = None,
    ) -> tuple[mi.Spectrum, mi.Float]:
        """BSDF value of ``lobe`` times the cosine for ``wo``, and the density of :meth:`sample` there; of all lobes in
        the lanes ``whole``.
        """
        f, pdf = workarounds.eval_pdf(lobe, si, bsdf, wo, active, self.mixes)
        if self.inseparable and whole is not None:
            f_all, pdf_all = bsdf.eval_pdf(lobes.everything(), si, wo, active & whole)
            f, pdf = dr.select(whole, f_all, f), dr.select(whole, pdf_all, pdf)
        return f, pdf

    def or_whole(
        self,
        f: mi.Spectrum,
        si: mi.SurfaceInteraction3f,
        bsdf: mi.BSDF | mi.BSDFPtr,
        wo: mi.Vector3f,
        active: mi.Bool,
        whole: mi.Bool,
    ) -> mi.Spectrum:
        """``f``, but the value of all lobes for ``wo`` in the lanes ``whole``."""
        if not self.inseparable:
            return f
        return dr.select(whole, bsdf.eval(lobes.everything(), si, wo, active & whole), f)

    def choice(self, points: Points, space: mi.UInt32, choice: mi.Float) -> mi.Float:
        """``choice``, the number that chooses a lobe or a wavelength, such that with dispersion the samples of a pixel
        together divide the spectrum evenly.
        """
        if not self.disperses or not mi.is_spectral or isinstance(points, SamplerPoints):
            return choice
        return wavelengths.kept(combine(points.key, space), *points.division, choice)


def sample_carried(
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
