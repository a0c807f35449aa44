"""Features of a camera ray for denoising: the normal of the first surface that the ray meets, and an albedo.

The albedo of a camera ray includes the albedo of surfaces that are visible through glass or in mirrors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi

from ..masks import but_not, idle
from . import lobes
from .absorption import UNBOUNDED, medium_before, medium_beyond, pointer, transmittance
from .ray import Surface, viewer_side
from .scattering import Scattering
from .workarounds import past_emitters

#: Channel names of the values that :func:`features` returns.
NAMES = ("albedo.R", "albedo.G", "albedo.B", "normal.X", "normal.Y", "normal.Z")

#: Maximum number of reflections and refractions that are followed, and the throughput below which a ray ends.
MAX_LEVEL, MIN_THROUGHPUT = 6, 0.01


@dataclass
class State:
    """State of the loop that follows a ray through specular surfaces; ``sampler`` draws random numbers."""

    ray: mi.Ray3f
    albedo: mi.Spectrum
    throughput: mi.Spectrum
    normal: mi.Normal3f
    active: mi.Bool
    level: mi.UInt32
    #: Whether the ray continues the camera ray, straight through holes of surfaces.
    passed: mi.Bool
    sampler: mi.Sampler
    #: The medium around the ray.
    medium: mi.MediumPtr


def features(
    scene: mi.Scene,
    sampler: mi.Sampler,
    ray: mi.Ray3f,
    active: mi.Bool,
    hide_emitters: bool = False,
    camera_medium: mi.Medium | None = None,
) -> tuple[mi.Spectrum, mi.Normal3f, mi.Bool]:
    """Returns ``(albedo, normal, hit)`` for the camera ray ``ray``; ``hit`` tells whether the ray meets a surface.

    The normal is the shading normal of the first surface, turned towards the viewer, or 0 if there is none. The albedo,
    in [0, 1], is a random sample of that of the diffuse lobes, plus the albedo of the next surface that a specular lobe
    shows, times a random sample of what this lobe and media on the way keep. The albedo of light sources and of the sky
    is their radiance, clipped to 1; ``hide_emitters`` hides both from the camera. ``camera_medium`` is the medium
    around the camera, or None.
    """
    scattering = Scattering(scene, separate=False)
    diffuse, specular = lobes.only(lobes.DIFFUSE), lobes.only(lobes.SPECULAR)

    def step(state: State) -> State:
        ray, active, medium, first = state.ray, state.active, state.medium, state.level == 0
        si = scene.ray_intersect(ray, active)
        if hide_emitters:
            si = past_emitters(scene, ray, si, active & state.passed, attached=False)
        albedo, throughput = state.albedo, state.throughput
        medium = medium_before(si, medium, ray.d, active & si.is_valid() & first)
        t = dr.select(si.is_valid(), si.t, UNBOUNDED)
        throughput = throughput * transmittance(medium, ray.wavelengths, t, active)
        emitter = si.emitter(scene)
        visible = but_not(active, state.passed) if hide_emitters else active
        if not idle(visible) and emitter is not None:
            albedo = albedo + dr.select(visible, throughput * dr.clip(emitter.eval(si, visible), 0, 1), 0)
        surface = active & si.is_valid()
        if idle(surface):
            return replace(state, albedo=albedo, active=surface)
        normal = dr.select(surface & first, viewer_side(si), state.normal)
        scattered, *_ = sample_albedo(si, diffuse, state.sampler, surface, scattering)
        weight, d, is_null = sample_albedo(si, specular, state.sampler, surface, scattering)
        albedo = albedo + dr.select(surface, throughput * scattered, 0)
        throughput = throughput * weight
        medium = medium_beyond(si, medium, d, surface)
        continues = surface & (state.level < MAX_LEVEL) & (dr.max(throughput) > MIN_THROUGHPUT)
        ray, level = si.spawn_ray(d), state.level + 1
        passed = state.passed & is_null
        return State(ray, albedo, throughput, normal, continues, level, passed, state.sampler, medium)

    medium = pointer(camera_medium)
    black, none = mi.Spectrum(0), mi.Normal3f(0)
    passed = mi.Bool(True)
    state = State(mi.Ray3f(ray), black, mi.Spectrum(1), none, mi.Bool(active), mi.UInt32(0), passed, sampler, medium)
    (state,) = dr.while_loop((state,), lambda state: state.active, lambda state: (step(state),))
    albedo = dr.select(dr.all(dr.isfinite(state.albedo)), dr.clip(state.albedo, 0, 1), 0)
    return albedo, state.normal, dr.squared_norm(state.normal) > 0


def sample_albedo(
    si: mi.SurfaceInteraction3f, lobe: mi.BSDFContext, sampler: mi.Sampler, active: mi.Bool, scattering: Scattering
) -> tuple[Any, mi.Vector3f, mi.Bool]:
    """Returns ``(weight, direction, is_null)`` of one sample of ``lobe`` at ``si``, the direction in world coordinates;
    the weight is 0 if the BSDF sampled another lobe. ``is_null`` tells whether it passes straight through.

    Dispersive glass refracts all wavelengths in the same direction: random wavelengths would make the mean albedo
    wrong, because each sample is clipped.
    """
    surface = Surface(si, si.bsdf(), active, mi.Bool(False))
    u = sampler.next_1d(active), sampler.next_2d(active)
    bs, weight, belongs = scattering.sample(lobe, surface, u, active)
    belongs &= active & (bs.pdf > 0)
    is_null = lobes.has_any(bs.sampled_type, "Null")
    return dr.select(belongs, mi.unpolarized_spectrum(weight), 0), si.to_world(bs.wo), is_null
