"""Radiance along a camera ray.

The radiance is computed by Whitted's ray tree (thesis, sections 4.1, 4.2), by Kajiya's paths (section 4.2.3), or by an
integrator of Mitsuba.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi

from ..light.emitter_methods import warn_of_wrong_light
from ..masks import but_not
from ..registry import create
from ..sampling.nrook import NRook, SamplerPoints
from ..sampling.sobol import Points, Sobol
from ..sampling.spaces import CAMERA_SPACES
from .differentiable_loop import differentiable_loop
from .next_ray import Path, Tree
from .radiance import Radiance
from .ray import Ray
from .shading import shade
from .transport_context import Context
from .workarounds import repair_boxes, warn_of_lost_light, warn_of_unused_render

#: About how many rays a path traces.
RAYS_PER_PATH = 10


@dataclass
class State:
    """State of the loop over the nodes of a ray tree, or over the vertices of a path."""

    L: Radiance
    #: None where camera rays that leave the scene see the sky or the background, so that all pixels are opaque.
    alpha: mi.Float | None
    ray: Ray
    active: mi.Bool
    progress: Tree | Path
    #: The ``mi.Sampler`` that draws the sampling points; None where the points have no state.
    sampler: mi.Sampler | None


class Transport(Context):
    """Estimates the radiance of camera rays in a scene; one object is used for all camera rays of a render."""

    @property
    def rays_per_sample(self) -> int:
        """About how many rays a sample traces; a ray tree is supposed to have one reflected or refracted ray."""
        if not self.settings.follows_tree:
            return RAYS_PER_PATH
        follows = self.settings.max_level > 0 and (self.reflects or self.refracts)
        return (1 + self.lights.lamps) * (2 if follows else 1)

    def __call__(
        self, ray: mi.Ray3f, points: Points, active: mi.Bool
    ) -> tuple[mi.Spectrum, mi.Float, list[mi.Spectrum]]:
        """Returns ``(L, alpha, layers)`` for the camera ray ``ray``: the radiance, the opacity, and the radiance of
        each image layer (:mod:`.radiance`). ``points`` are the random numbers of the sample.

        The opacity is 1, less the throughput with which the ray leaves the scene, straight through holes of surfaces,
        where it sees neither the sky nor the background.
        """
        walk: Any = Tree if self.settings.follows_tree else Path

        def step(state: State) -> State:
            L, vertex = shade(self, state.ray, ray, points, state.active)
            alpha = state.alpha
            if alpha is not None:
                escaped = but_not(state.active & vertex.ray.is_visible, vertex.si.is_valid())
                throughput = dr.mean(mi.unpolarized_spectrum(dr.detach(vertex.ray.throughput)))
                alpha = alpha - dr.select(escaped, throughput, 0)
            next_ray, next_active, progress = state.progress.proceed(self, vertex, points, state.active)
            return State(state.L + L, alpha, next_ray, next_active, progress, state.sampler)

        first, sampler = self.first(ray), points.sampler if isinstance(points, SamplerPoints) else None
        alpha = None if self.shows_sky else mi.Float(1)
        state = State(self.no_light(), alpha, first, mi.Bool(active), walk.start(self, first), sampler)
        if walk is Tree and not (self.reflects or self.refracts):  # no ray follows the camera ray
            state = step(state)
        elif self.attached:
            state = differentiable_loop(state, step)
        else:
            (state,) = dr.while_loop((state,), lambda state: state.active, lambda state: (step(state),))
        return state.L.total, mi.Float(1) if state.alpha is None else state.alpha, state.L.layers


class InnerIntegrator:
    """Estimates radiance as :class:`Transport` does, but by an integrator of Mitsuba."""

    #: The integrator computes its own photons and layers, if it has any.
    caustics, has_layers, rays_per_sample = None, False, RAYS_PER_PATH

    def __init__(self, integrator: mi.SamplingIntegrator, scene: mi.Scene, medium: mi.Medium | None = None) -> None:
        repair_boxes(scene)
        warn_of_unused_render(integrator)
        warn_of_lost_light(scene, integrator)
        warn_of_wrong_light(scene.emitters())
        self.integrator, self.scene, self.medium = integrator, scene, medium
        #: Names of the AOVs that a call returns after the radiance and the hit.
        self.aov_names = list(integrator.aov_names())

    def __call__(
        self, ray: mi.RayDifferential3f, points: Points, active: mi.Bool
    ) -> tuple[mi.Spectrum, mi.Float, list[mi.Float]]:
        """Returns ``(L, alpha, aovs)`` for the camera ray ``ray``; ``alpha`` is 1 where the integrator reports a hit,
        else 0. Its random numbers are those of ``points``.
        """
        sampler = points.sampler if isinstance(points, SamplerPoints) else sampler_of(points)
        if not dr.is_jit_v(mi.Float) or not isinstance(self.integrator, mi.CppADIntegrator):
            L, hit, aovs = self.integrator.sample(self.scene, sampler, ray, self.medium, active)
            return L, dr.select(hit, mi.Float(1), 0), [mi.Float(v) for v in aovs]  # a user's may be numbers of Python
        # Mitsuba's integrators for derivatives, such as prb, have another signature of ``sample``.
        rest = {"depth": mi.UInt32(0), "δL": None, "δaovs": None, "state_in": None, "active": mi.Bool(active)}
        L, hit, aovs, _ = self.integrator.sample(dr.ADMode.Primal, self.scene, sampler, ray, **rest)
        return L, dr.select(hit, mi.Float(1), 0), list(aovs)


#: Estimates the radiance of camera rays.
RadianceEstimator: TypeAlias = Transport | InnerIntegrator


def sampler_of(points: NRook | Sobol) -> Any:
    """Returns a ``mi.Sampler`` over ``points``: each call uses the next space after those of the camera."""
    # The sampler calls its method ``points`` for each draw. Here this method returns the pattern of the caller.
    sampler = create("owen")
    sampler.points, sampler.dimension = lambda: points, mi.UInt32(CAMERA_SPACES)
    return sampler
