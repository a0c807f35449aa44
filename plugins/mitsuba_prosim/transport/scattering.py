"""Lobes of BSDFs, sampled and evaluated with the workarounds that a scene needs and with dispersion (Thomas 1986)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi

from ..masks import dispatch, idle
from ..optics.nested import all_shapes
from ..sampling import wavelengths
from ..sampling.hash import combine
from ..sampling.nrook import SamplerPoints
from ..sampling.sobol import Points
from . import lobes, workarounds

#: One BSDF, or a Dr.Jit array of them.
AnyBSDF: TypeAlias = "mi.BSDF | mi.BSDFPtr"


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
    #: Whether any BSDF has no separable lobes, so that all are evaluated together.
    any_inseparable: bool

    @classmethod
    def of(cls, scene: mi.Scene, separate: bool = True) -> Scattering:
        """The BSDFs of ``scene``. ``separate``: whether lobes are evaluated separately at all."""
        bsdfs = [shape.bsdf() for shape in all_shapes(scene) if shape.bsdf() is not None]
        inseparable = separate and any(map(workarounds.is_inseparable, bsdfs))
        return cls(disperses(scene), any(map(workarounds.is_mixed, bsdfs)), inseparable)

    def inseparable(self, bsdf: AnyBSDF, active: mi.Bool) -> mi.Bool:
        """The active lanes whose BSDF has no separable lobes."""
        if not self.any_inseparable:
            return mi.Bool(False)
        return active & dispatch(bsdf, lambda one, active: mi.Bool(workarounds.is_inseparable(one)), active)

    def sample(
        self,
        lobe: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        bsdf: AnyBSDF,
        choice: mi.Float,
        point: mi.Point2f,
        throughput: mi.Spectrum | None,
        active: mi.Bool,
        inseparable: mi.Bool | None = None,
    ) -> tuple[mi.BSDFSample3f, mi.Spectrum, mi.Bool]:
        """``(bs, weight, belongs)``: a sample of ``lobe``, and whether it is one of that lobe.

        ``choice``: a number in [0, 1) that chooses among lobes. ``throughput``: of the ray, for dispersion, or None. In
        the lanes ``inseparable`` all lobes are sampled together, and each sample belongs to one of those that have a
        ray of their own.
        """
        bs, weight = self._sample(lobe, si, bsdf, choice, point, throughput, active)
        # thindielectric samples lobes outside of the type mask: these have a ray of their own.
        belongs = (bs.sampled_type & lobe.type_mask) != 0
        if not self.any_inseparable or inseparable is None or idle(active & inseparable):
            return bs, weight, belongs
        every = lobes.everything(lobe.mode)
        bs_all, weight_all = self._sample(every, si, bsdf, choice, point, None, active & inseparable)
        belongs_all = workarounds.belongs_to(lobe, si.wi, bs_all)
        return dr.select(inseparable, (bs_all, weight_all, belongs_all), (bs, weight, belongs))

    def _sample(
        self,
        lobe: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        bsdf: AnyBSDF,
        choice: mi.Float,
        point: mi.Point2f,
        throughput: mi.Spectrum | None,
        active: mi.Bool,
    ) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
        """``(bs, weight)`` of the ``lobe`` of ``bsdf``. Dispersive, ideally smooth glass refracts one of the
        wavelengths of the ray, chosen by their ``throughput``; without a throughput all, in one direction.
        """
        if not self.disperses and not self.mixes:
            return bsdf.sample(lobe, si, choice, point, active)
        weights = None
        if self.disperses and throughput is not None:
            values = [dr.maximum(t, 0) for t in dr.detach(mi.unpolarized_spectrum(throughput))]
            total = sum(values, mi.Float(0))
            weights = [dr.select(total > 0, t / dr.select(total > 0, total, 1), 1 / len(values)) for t in values]

        def sample(one: mi.BSDF, weights: list[mi.Float] | None, *args: Any) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
            if getattr(one, "disperses", False):
                return one.sample_dispersed(lobe, *args[:-1], weights, args[-1])
            return workarounds.sample(lobe, one, *args)

        return dispatch(bsdf, sample, weights, si, choice, point, active)

    def eval_pdf(
        self,
        lobe: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        bsdf: AnyBSDF,
        wo: mi.Vector3f,
        active: mi.Bool,
        inseparable: mi.Bool | None = None,
    ) -> tuple[mi.Spectrum, mi.Float]:
        """BSDF value of ``lobe`` times the cosine for ``wo``, and the density of :meth:`sample` there; of all lobes in
        the lanes ``inseparable``.
        """
        if self.mixes:
            f, pdf = dispatch(bsdf, lambda one, *args: workarounds.eval_pdf(lobe, one, *args), si, wo, active)
        else:
            f, pdf = bsdf.eval_pdf(lobe, si, wo, active)
        if self.any_inseparable and inseparable is not None:
            of_all = bsdf.eval_pdf(lobes.everything(), si, wo, active & inseparable)
            f, pdf = dr.select(inseparable, of_all, (f, pdf))
        return f, pdf

    def or_all_lobes(
        self,
        f: mi.Spectrum,
        si: mi.SurfaceInteraction3f,
        bsdf: AnyBSDF,
        wo: mi.Vector3f,
        active: mi.Bool,
        inseparable: mi.Bool,
    ) -> mi.Spectrum:
        """``f``, but the value of all lobes for ``wo`` in the lanes ``inseparable``."""
        if not self.any_inseparable:
            return f
        return dr.select(inseparable, bsdf.eval(lobes.everything(), si, wo, active & inseparable), f)

    def choice(self, points: Points, space: mi.UInt32, choice: mi.Float) -> mi.Float:
        """``choice``, the number that chooses a lobe or a wavelength, such that with dispersion the samples of a pixel
        together divide the spectrum evenly.
        """
        if not self.disperses or not mi.is_spectral or isinstance(points, SamplerPoints):
            return choice
        return wavelengths.chosen(combine(points.key, space), *points.division, choice)
