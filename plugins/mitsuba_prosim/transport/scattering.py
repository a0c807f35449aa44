"""Sampling and evaluation of the lobes of BSDFs, with workarounds for Mitsuba and with dispersion (Thomas 1986)."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..compat import BLEND, CHOOSERS, MASK
from ..masks import dispatch
from ..optics.nested import all_bsdfs, all_within
from ..sampling import wavelengths
from ..sampling.hash import combine
from ..sampling.nrook import SamplerPoints
from ..sampling.sobol import Points
from . import workarounds
from .lobes import LobePoint
from .ray import Surface


def disperses(scene: mi.Scene) -> bool:
    """Tells whether a BSDF refracts each wavelength differently: its attribute ``disperses`` is true."""
    return any(getattr(bsdf, "disperses", False) for bsdf in all_bsdfs(scene))


class Scattering:
    """Samples and evaluates lobes of the BSDFs of ``scene``; separately or, without ``separate``, all together.

    ``whole`` tells that each request is for all lobes. Then a ``mask`` needs no workaround, nor most of ``blendbsdf``.
    ``attached`` tells whether derivatives are wanted.
    """

    def __init__(self, scene: mi.Scene, separate: bool = True, whole: bool = False, attached: bool = False) -> None:
        bsdfs = all_bsdfs(scene)
        kinds = (MASK, BLEND, *CHOOSERS) if attached else (MASK, BLEND)
        mixes = any(one.class_name() in kinds for bsdf in bsdfs for one in all_within(bsdf))
        if whole and not attached:
            mixes = any(workarounds.mixes_wrongly(mi.BSDFContext(), bsdf) for bsdf in bsdfs)
        self.attached = attached
        #: Whether any BSDF of the scene refracts each wavelength in another direction.
        self.disperses = disperses(scene)
        #: Whether any BSDF of the scene can only evaluate all its lobes together.
        self.any_inseparable = separate and any(map(workarounds.is_inseparable, bsdfs))
        #: Whether a BSDF of the scene needs one of the :mod:`.workarounds`.
        self.needs_workarounds = self.any_inseparable or mixes or any(map(workarounds.of_users, bsdfs))

    def inseparable(self, bsdf: mi.BSDF | mi.BSDFPtr, active: mi.Bool) -> mi.Bool:
        """Returns the active lanes whose BSDF is :func:`.is_inseparable`; none without ``separate``."""
        if not self.any_inseparable:
            return mi.Bool(False)
        return active & dispatch(bsdf, lambda one, active: mi.Bool(workarounds.is_inseparable(one)), active)

    def sample(
        self, lobe: mi.BSDFContext, at: Surface, u: LobePoint, active: mi.Bool, throughput: mi.Spectrum | None = None
    ) -> tuple[mi.BSDFSample3f, mi.Spectrum, mi.Bool]:
        """Returns ``(bs, weight, belongs)``: a BSDF sample at the surface point ``at`` by the random numbers ``u``, and
        whether the sample belongs to ``lobe``.

        ``throughput`` is that of the arriving ray, or the flux of the arriving photon. Dispersive, ideally smooth glass
        chooses the wavelength that it refracts in proportion to ``throughput``; if this is None, it refracts all in one
        direction. Where ``at.inseparable``, the BSDF samples all lobes together.
        """
        weights = None
        if self.disperses and throughput is not None:
            values = [dr.maximum(t, 0) for t in dr.detach(mi.unpolarized_spectrum(throughput))]
            total = sum(values, mi.Float(0))
            weights = [dr.select(total > 0, t / dr.select(total > 0, total, 1), 1 / len(values)) for t in values]

        def sample(
            one: mi.BSDF, si: mi.SurfaceInteraction3f, u: LobePoint, weights: list[mi.Float] | None, active: mi.Bool
        ) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
            if getattr(one, "disperses", False):
                return one.sample(lobe, si, *u, active, weights, undispersed=weights is None)
            return workarounds.sample(lobe, one, si, u, active, self.attached)

        if self.disperses or self.needs_workarounds:
            bs, weight = dispatch(at.bsdf, sample, at.si, u, weights, active)
        else:
            bs, weight = at.bsdf.sample(lobe, at.si, *u, active)
        # Some BSDFs sample lobes outside of the type mask. Those lobes have a ray of their own.
        belongs = (bs.sampled_type & lobe.type_mask) != 0
        if self.any_inseparable:
            belongs = dr.select(at.inseparable, workarounds.belongs_to(lobe, at.si.wi, bs), belongs)
        return bs, weight, belongs

    def eval_pdf(
        self, lobe: mi.BSDFContext, at: Surface, wo: mi.Vector3f, active: mi.Bool
    ) -> tuple[mi.Spectrum, mi.Float]:
        """Returns the BSDF value of ``lobe`` times the cosine for the direction ``wo``, and the density with which
        :meth:`sample` samples ``wo``; those of all lobes where ``at.inseparable``.
        """
        if self.needs_workarounds:
            return dispatch(at.bsdf, lambda one, *args: workarounds.eval_pdf(lobe, one, *args), at.si, wo, active)
        return at.bsdf.eval_pdf(lobe, at.si, wo, active)

    def eval(self, lobe: mi.BSDFContext, at: Surface, wo: mi.Vector3f, active: mi.Bool) -> mi.Spectrum:
        """Returns the value of ``lobe`` times the cosine of ``wo``; of all lobes where ``at.inseparable``."""
        if self.any_inseparable:
            return dispatch(at.bsdf, lambda one, *args: workarounds.evaluate(lobe, one, *args), at.si, wo, active)
        return at.bsdf.eval(lobe, at.si, wo, active)

    def lobe_choice(self, points: Points, space: mi.UInt32, choice: mi.Float) -> mi.Float:
        """Returns the random number in [0, 1) by which a BSDF chooses a lobe or a wavelength: ``choice``, which is that
        of ``space``; with dispersion in spectral variants, modified so that the samples of a pixel together cover the
        spectrum evenly, except for a Mitsuba sampler.
        """
        if not self.disperses or not mi.is_spectral or isinstance(points, SamplerPoints):
            return choice
        return wavelengths.wavelength_choice(combine(points.key, space), *points.division, choice)
