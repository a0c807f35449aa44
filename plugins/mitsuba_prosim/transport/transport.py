"""Radiance along a camera ray.

One of three methods computes the radiance: Whitted's tree (thesis, sections 4.1, 4.2), Kajiya's paths (section 4.2.3),
or an integrator of Mitsuba.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ..registry import create
from ..sampling.nrook import NRook, SamplerPoints
from ..sampling.sobol import Points, Sobol
from . import path, tree
from .differentiable_loop import differentiable_loop
from .radiance import Radiance
from .ray import Ray
from .transport_context import CAMERA_SPACES, Context
from .vertex import shade


@dataclass
class State:
    """State of the loop over the nodes of a ray tree, or over the vertices of a path."""

    L: Radiance
    hit: mi.Bool
    ray: Ray
    active: mi.Bool
    #: The rays of the tree that are still to follow, or the counters of the path.
    progress: tree.Stack | path.Counters
    #: The ``mi.Sampler`` that draws the sampling points; None where the points have no state.
    sampler: mi.Sampler | None


class Transport(Context):
    """Estimates the radiance of camera rays in a scene; one object serves a whole render."""

    def __call__(
        self, ray: mi.Ray3f, points: Points, active: mi.Bool
    ) -> tuple[mi.Spectrum, mi.Bool, list[mi.Spectrum]]:
        """Returns ``(L, hit, layers)`` for the camera ray ``ray``.

        ``L`` is the radiance, ``hit`` tells whether the ray met a surface, and ``layers`` has the radiance of each
        image layer (:mod:`.radiance`). The function ``points(space, active)`` returns a ``mi.Point2f`` in [0, 1)² for
        one space of the sampling pattern; ``points.choice(space)`` returns one number in [0, 1).
        """
        walk: Any = tree if self.settings.follows_tree else path

        def step(state: State) -> State:
            """Follows one ray: adds the light at its end to the radiance, and samples the next ray."""
            L, vertex = shade(self, state.ray, ray, points, state.active)
            hit = state.hit | (state.ray.level == 0) & vertex.active
            next_ray, next_active, progress = walk.proceed(self, vertex, points, state.active, state.progress)
            return State(state.L + L, hit, next_ray, next_active, progress, state.sampler)

        first, sampler = self.first(ray), points.sampler if isinstance(points, SamplerPoints) else None
        state = State(self.layers.none(), mi.Bool(False), first, mi.Bool(active), walk.start(self, first), sampler)
        if walk is tree and not (self.reflects or self.refracts):
            state = step(state)
        elif self.attached:
            state = differentiable_loop(state, step)
        else:
            (state,) = dr.while_loop((state,), lambda state: state.active, lambda state: (step(state),))
        return state.L.total, state.hit, state.L.layers


class InnerIntegrator:
    """Estimates radiance in ``scene`` by a ``mi.SamplingIntegrator``; one object serves a whole render.

    The class has the interface of :class:`Transport`.
    """

    #: The integrator computes its own photons and layers, if it has any.
    caustics, has_layers = None, False

    def __init__(self, integrator: mi.SamplingIntegrator, scene: mi.Scene, medium: mi.Medium | None = None) -> None:
        self.integrator, self.scene, self.medium = integrator, scene, medium
        #: Names of the AOVs that a call returns after the radiance and the hit.
        self.aov_names = list(integrator.aov_names())

    def __call__(self, ray: mi.Ray3f, points: Points, active: mi.Bool) -> tuple[mi.Spectrum, mi.Bool, list[mi.Float]]:
        """Returns ``(L, hit, aovs)`` for the camera ray ``ray``: the radiance, whether the integrator counts the ray as
        a hit, and the values of the integrator's AOVs.

        The integrator draws random numbers from ``points``; the camera's spaces of the sampling pattern are skipped.
        """
        sampler = points.sampler if isinstance(points, SamplerPoints) else sampler_of(points)
        ray = mi.RayDifferential3f(ray)
        if not dr.is_jit_v(mi.Float) or not isinstance(self.integrator, mi.CppADIntegrator):
            L, hit, aovs = self.integrator.sample(self.scene, sampler, ray, self.medium, active)
            return L, hit, list(aovs)
        # Mitsuba's integrators for derivatives, such as prb, have another signature of ``sample``.
        rest = {"depth": mi.UInt32(0), "δL": None, "δaovs": None, "state_in": None, "active": mi.Bool(active)}
        L, hit, aovs, _ = self.integrator.sample(dr.ADMode.Primal, self.scene, sampler, ray, **rest)
        return L, hit, list(aovs)


def sampler_of(points: NRook | Sobol) -> Any:
    """Returns a ``mi.Sampler`` whose random numbers are those of ``points``.

    Each number that is drawn belongs to the next space of the sampling pattern; the camera's spaces are skipped.
    """
    sampler = create("owen")
    sampler.points, sampler.dimension = lambda: points, mi.UInt32(CAMERA_SPACES)
    return sampler
