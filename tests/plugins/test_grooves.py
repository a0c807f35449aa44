"""Reflection of light between the facets of a V-shaped groove, compared with rays that are followed one by one."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scipy
from drawing.curves import interaction
from scenes import derivative, slow

RAYS = 300_000
ROUGHNESSES = [("alpha", 0.3), ("alpha", 1.5), ("exponent", 4.0), ("gaussian", 0.8)]
MATERIALS = {
    "conductor": {"type": "prosim_conductor", "eta": 0.3, "k": 2.0},
    "composite": {"type": "prosim_composite", "diffuse_reflectance": 0.0, "int_ior": 2.5},
    "dielectric": {"type": "prosim_dielectric", "int_ior": 2.5},
}


#: Each roughness once, in turn of a metal and of glass.
GROOVES = [(kind, *ROUGHNESSES[k]) for k, kind in enumerate(["conductor", "dielectric"] * 2)]


def material(kind, roughness, value, **parameters):
    named = {"alpha": value, "distribution": "gaussian"} if roughness == "gaussian" else {roughness: value}
    return mi.load_dict({**MATERIALS[kind], **named, "multiple_scattering": True, **parameters})


def tilts(roughness, value, u):
    """Polar angles of facets, sampled in proportion to D cos by ``u``."""
    if roughness == "alpha":
        return np.arctan(value * np.sqrt(-np.log1p(-u)))
    if roughness == "exponent":
        return np.arccos((1 - u) ** (1 / (value + 2)))
    angles = np.linspace(0, np.pi / 2, 100_001)
    density = np.exp(-((angles / value) ** 2)) * np.sin(2 * angles)
    distribution = np.cumsum(density)
    return np.interp(u, distribution / distribution[-1], angles)


def walk(wi, roughness, value, reflectance, rng):
    """Follows rays through grooves; returns the directions in which they leave, and the light that remains."""
    tilt, azimuth = tilts(roughness, value, rng.random(RAYS)), 2 * np.pi * rng.random(RAYS)
    across = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    # In the plane across the groove: position, direction; along the groove, the direction never changes.
    position = np.stack([(2 * rng.random(RAYS) - 1) * np.cos(tilt), np.sin(tilt)], axis=1)
    direction = np.stack([-(across @ wi[:2]), np.full(RAYS, -wi[2])], axis=1)
    along = -wi[:2] + (across @ wi[:2])[:, None] * across
    light, alive = np.ones(RAYS), np.ones(RAYS, bool)
    normals = [np.stack([side * np.sin(tilt), np.cos(tilt)], axis=1) for side in (1, -1)]
    last = np.full(RAYS, -1)
    for _ in range(100):
        best, hit = np.full(RAYS, np.inf), np.full(RAYS, -1)
        for number, normal in enumerate(normals):
            toward = (direction * normal).sum(1)
            distance = -(position * normal).sum(1) / np.where(toward < 0, toward, -1)
            height = position[:, 1] + distance * direction[:, 1]
            valid = (toward < 0) & (height > 0) & (height < np.sin(tilt)) & (number != last) & (distance < best)
            best, hit = np.where(valid, distance, best), np.where(valid, number, hit)
        alive &= hit >= 0
        if alive.mean() < 1e-4:
            break
        normal = np.where((hit == 0)[:, None], *normals)
        cos = -(direction * normal).sum(1)
        light = np.where(alive, light * np.asarray(reflectance(np.where(alive, cos, 1))), light)
        step = np.where(alive, best, 0)[:, None]
        position, last = position + step * direction, np.where(alive, hit, last)
        direction = np.where(alive[:, None], direction + 2 * cos[:, None] * normal, direction)
    xy = direction[:, :1] * across + along
    return np.column_stack([xy, direction[:, 1]]), light


@pytest.mark.slow
@pytest.mark.parametrize("kind, roughness, value", GROOVES)
def test_groove_reflects_as_rays_followed_one_by_one(variant_rgb, kind, roughness, value):
    """Energy in 30 bins of direction for a grazing and a steep ray; significance 0.001 for all bins together."""
    rng = np.random.default_rng(1)
    if kind == "conductor":
        reflectance = lambda c: mi.fresnel_conductor(mi.Float(c), mi.Complex2f(0.3, 2.0))  # noqa: E731
    else:
        reflectance = lambda c: mi.fresnel(mi.Float(c), 2.5)[0]  # noqa: E731
    bsdf = material(kind, roughness, value)
    for angle in (20, 70):
        wi = np.array([np.sin(np.radians(angle)), 0, np.cos(np.radians(angle))])
        wo, light = walk(wi, roughness, value, reflectance, rng)
        light = np.where(wo[:, 2] > 0, light, 0)  # one ray in 10,000 has not yet left the steepest grooves
        bins = (
            np.clip((wo[:, 2] * 5).astype(int), 0, 4) * 6
            + np.floor(np.arctan2(wo[:, 1], wo[:, 0]) / np.pi * 3 + 3).astype(int) % 6
        )
        expected = np.bincount(bins, light, 30) / RAYS
        variance = np.bincount(bins, light**2, 30) / RAYS - expected**2
        u = rng.random((3, 30, 1 << 15))
        z = (np.arange(30)[:, None] // 6 + u[0]) / 5
        phi = (np.arange(30)[:, None] % 6 + u[1]) * np.pi / 3 - np.pi
        w = mi.Vector3f(*(x.ravel() for x in (np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z)))
        values = np.array(bsdf.eval(mi.BSDFContext(), interaction(mi.Vector3f(wi)), w))[0].reshape(30, -1)
        values *= 2 * np.pi / 30
        # Few rays say little of their own variance; light that is at most 1 has at most the variance of its mean.
        variance = np.where(np.bincount(bins, minlength=30) < 100, values.mean(1), variance)
        error = variance / RAYS + values.var(1) / values.shape[1] + 1e-12
        score = ((values.mean(1) - expected) ** 2 / error).sum()
        assert scipy.stats.chi2.sf(score, 30) > 0.001, (angle, values.mean(1), expected)


@pytest.mark.parametrize("kind", ["conductor", *slow("composite", "dielectric")])
def test_derivative_in_a_call_of_several_bsdfs_is_a_finite_difference(variant_rgb, kind):
    """Dr.Jit 1.5 ended the process."""
    bsdf, other = material(kind, "alpha", 0.5), mi.load_dict({"type": "diffuse"})
    params = mi.traverse(bsdf)
    name = next(key for key in params.keys() if "alpha" in key)  # noqa: SIM118 (not a dict)
    rng = np.random.default_rng(3)
    wi, wo = (mi.Vector3f(x / np.linalg.norm(x, axis=0)) for x in np.abs(rng.normal(size=(2, 3, 64))))
    si = interaction(wi)

    def total(alpha):
        params[name] = alpha
        params.update()
        chosen = dr.select(dr.arange(mi.UInt32, 64) < 32, mi.BSDFPtr(bsdf), mi.BSDFPtr(other))
        return dr.sum(chosen.eval(mi.BSDFContext(), si, wo).x)

    difference = (total(mi.Float(0.51)) - total(mi.Float(0.49)))[0] / 0.02
    assert derivative(total, 0.5) == pytest.approx(difference, rel=5e-3, abs=1e-3)
