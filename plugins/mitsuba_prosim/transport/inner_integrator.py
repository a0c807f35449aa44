"""Radiance along a camera ray by another integrator."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..registry import create
from ..sampling.nrook import NRook, SamplerPoints
from ..sampling.sobol import Points, Sobol
from .context import CAMERA_SPACES


class InnerIntegrator:
    """Asks ``integrator``, a ``mi.SamplingIntegrator``, for the radiance in ``scene``; made once a render.

    Stands in the place of :class:`.Transport`.
    """

    #: That integrator's own business.
    caustics = None

    def __init__(self, integrator: mi.SamplingIntegrator, scene: mi.Scene, medium: mi.Medium | None = None) -> None:
        self.integrator, self.scene, self.medium = integrator, scene, medium
        #: Names of the values that come third.
        self.aov_names = list(integrator.aov_names())

    def __call__(self, ray: mi.Ray3f, points: Points, active: mi.Bool) -> tuple[mi.Spectrum, mi.Bool, list[mi.Float]]:
        """Radiance of the camera ray ``ray``: ``(L, hit, others)``, with points for each dimension in turn: those of
        ``points``, in the spaces after the camera's.
        """
        sampler = points.sampler if isinstance(points, SamplerPoints) else sampler_of(points)
        return self.radiance(sampler, mi.RayDifferential3f(ray), self.medium, active)

    def radiance(
        self, sampler: mi.Sampler, ray: mi.RayDifferential3f, medium: mi.Medium | None, active: mi.Bool
    ) -> tuple[mi.Spectrum, mi.Bool, list[mi.Float]]:
        """The same with a sampler of Mitsuba's."""
        if not is_differential(self.integrator):
            L, hit, others = self.integrator.sample(self.scene, sampler, ray, medium, active)
            return L, hit, list(others)
        # Mitsuba's integrators for derivatives, in Python, have a method of their own.
        L, hit, others, _ = self.integrator.sample(
            mode=dr.ADMode.Primal,
            scene=self.scene,
            sampler=sampler,
            ray=ray,
            depth=mi.UInt32(0),
            δL=None,
            δaovs=None,
            state_in=None,
            active=mi.Bool(active),
        )
        return L, hit, list(others)


def is_differential(integrator: mi.Integrator) -> bool:
    """Whether ``integrator`` is one of Mitsuba's for derivatives, such as ``prb``."""
    return dr.is_jit_v(mi.Float) and isinstance(integrator, mi.CppADIntegrator)


def sampler_of(points: NRook | Sobol) -> Any:
    """A ``mi.Sampler`` that gives ``points``, space by space."""
    if isinstance(points, Sobol):
        sampler = create("owen")
    else:
        sampler = create("nrook", jitter=points.jitter)
        sampler.permutations = points.permutations
    sampler.pixel, sampler.index = points.key, points.t
    sampler.dimension = mi.UInt32(CAMERA_SPACES)
    return sampler
