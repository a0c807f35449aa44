"""Surfaces whose lobes have to be asked for with care: ``mask`` and ``blendbsdf``, in the tree and along paths."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from mitsuba_prosim.transport import lobes, workarounds
from scenes import FLAT, T, bitmap, camera, film, load_scene, rectangle, sphere_lamp

MIRROR = {"type": "conductor"}
BLACK = {"type": "diffuse", "reflectance": 0.0}
BLACK_ROUGH = {"type": "roughconductor", "alpha": 0.3, "specular_reflectance": 0.0}
ROUGH = {"type": "roughconductor", "alpha": 0.3}
WHOLE = {"type": "principled", "base_color": 0.5, "roughness": 0.4}

bounces = pytest.mark.parametrize("bounces", [0, 3, -1], ids=["tree", "paths by two rays", "paths"])


def masked(bsdf, opacity=0.6):
    return {"type": "mask", "opacity": opacity, "b": bsdf}


def blended(a, b, weight=0.5):
    return {"type": "blendbsdf", "weight": weight, "a": a, "b": b}


def two_sided(bsdf):
    return {"type": "twosided", "b": bsdf}


def behind_black(bsdf):
    return {"type": "twosided", "a": BLACK, "b": bsdf}


def quarters(bsdfs, bounces, light, samples=16, size=16):
    """Four cards in one plane, alike as seen from the camera, which is above their common corner: the pixels of each,
    an array (4, size² / 4), and the standard errors of their means.
    """
    cards = {
        f"card {k}": rectangle(T().translate([x, y, 0]), bsdf=bsdf)
        for k, (bsdf, (x, y)) in enumerate(zip(bsdfs, ((1, 1), (-1, 1), (1, -1), (-1, -1)), strict=True))
    }
    scene = load_scene(
        integrator={"type": "prosim", "adaptive": "none", "samples": samples, "diffuse_bounces": bounces},
        sensor=camera([0, 0, 5], [0, 0, 0], film(size, pixel_format="luminance"), fov=20),
        light=light,
        **cards,
    )
    image = np.array(mi.render(scene, seed=1))[..., 0].astype(float)
    half = size // 2
    pixels = image.reshape(2, half, 2, half).transpose(0, 2, 1, 3)[:, ::-1].reshape(4, -1)
    return pixels.mean(1), pixels.std(1, ddof=1) / half


@bounces
def test_ideal_lobes_under_an_even_sky(variant_rgb, bounces):
    """A perfect mirror, and what lies behind, are as bright as the sky. A blend loses what its black half takes.

    Each of twelve differences, where there is noise at all, is below 4 standard errors (p < 1e-3 together).
    """
    bsdfs = masked(MIRROR), masked(masked(MIRROR), 0.7), blended(MIRROR, BLACK), blended(BLACK_ROUGH, MIRROR, 0.6)
    mean, error = quarters(bsdfs, bounces, {"type": "constant", "radiance": 1.0})
    assert (error < 0.01).all()
    assert (np.abs(mean - [1, 1, 0.5, 0.6]) < 4 * error + 1e-5).all(), (mean, error)


@pytest.mark.slow
@bounces
def test_rough_lobes_share_the_light_of_a_source(variant_rgb, bounces):
    """A part of a rough metal that is masked, or mixed with what is black, is so much darker (p < 1e-3 together)."""
    dark = {"type": "conductor", "specular_reflectance": 0.0}
    bsdfs = ROUGH, masked(ROUGH), blended(ROUGH, dark, 0.4), masked(blended(dark, ROUGH, 0.7))
    mean, error = quarters(bsdfs, bounces, sphere_lamp([0, 0, 9], 1.5, 10.0))
    shares = np.array([1, 0.6, 0.6, 0.42])
    difference = mean - mean[0] * shares
    assert (error[0] < 0.02 * mean[0]) and (error < 0.05 * mean).all()
    assert (np.abs(difference[1:]) < 4 * np.hypot(error, error[0] * shares)[1:]).all(), (mean / mean[0], error)


@pytest.mark.slow
@pytest.mark.parametrize("bounces", [0, -1], ids=["tree", "paths"])
def test_a_mirror_is_as_bright_in_a_blend_with_what_is_taken_whole(variant_rgb, bounces):
    """Under an even sky each adds its share (six differences within 4 standard errors: p < 1e-3 together)."""
    mixed = blended(MIRROR, WHOLE, 0.6)
    bsdfs = WHOLE, blended(WHOLE, MIRROR, 0.4), two_sided(mixed), masked(blended(WHOLE, MIRROR, 0.6), 0.5)
    mean, error = quarters(bsdfs, bounces, {"type": "constant", "radiance": 1.0})
    expected = mean[0] * np.array([1, 0.6, 0.6, 0.2]) + [0, 0.4, 0.4, 0.8]
    assert (error < 0.01).all()
    assert (np.abs(mean - expected) < 4 * np.hypot(error, error[0]) + 1e-5).all(), (mean, expected, error)


@pytest.mark.parametrize("other", [BLACK, WHOLE], ids=["apart", "whole"])
@pytest.mark.parametrize(
    "wrap, z, through",
    [(lambda b: masked(b, 0.3), 0.8, 0.7), (two_sided, 0.8, 0), (two_sided, -0.8, 0), (behind_black, -0.8, 0)],
    ids=["mask", "front", "back", "back alone"],
)
def test_the_derivative_by_a_share_is_that_of_ideal_lobes_too(variant_rgb, other, wrap, z, through):
    """A mirror has a share w in a blend of the weight w, from either side, and what passes straight through none of
    it.
    """
    bsdf = mi.load_dict(wrap(blended(other, MIRROR | {"specular_reflectance": 0.5}, 0.4)))
    params = mi.traverse(bsdf)
    (key,) = (key for key, _ in params if key.endswith("weight.value"))
    dr.enable_grad(params[key])
    params.update()
    n = 10_000
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.wi = mi.Vector3f(0.6, 0, z)
    choice = (dr.arange(mi.Float, n) + 0.5) / n
    bs, weight = workarounds.sample(lobes.all_lobes(), bsdf, si, (choice, mi.Point2f(0.3, 0.6)), mi.Bool(True))
    ideal = lobes.has_any(bs.sampled_type, *lobes.IDEAL) & (bs.pdf > 0)
    brought = dr.mean(dr.select(ideal, weight.x, 0))
    assert brought[0] == pytest.approx(through + 0.5 * (1 - through) * 0.4, abs=2e-3)
    mirrored = lobes.has_any(bs.sampled_type, "DeltaReflection") & (bs.pdf > 0)
    assert dr.all(~mirrored | (dr.norm(bs.wo - mi.Vector3f(-0.6, 0, z)) < 1e-5))
    dr.backward(brought)
    assert dr.grad(params[key])[0] == pytest.approx(0.5 * (1 - through), rel=5e-3)


def test_a_map_around_a_blend_that_dims_gives_a_warning(variant_rgb, logged):
    """And two maps within a blend, as the warning says, leave the mirror its share."""

    def bumped(bsdf):
        return {"type": "bumpmap", "texture": bitmap(FLAT), "b": bsdf}

    good = blended(bumped(WHOLE), bumped(MIRROR), 0.4)
    for bsdf in (good, bumped(blended(BLACK, MIRROR)), two_sided(bumped(blended(WHOLE, MIRROR)))):
        workarounds.warn_of_dim_lobes(load_scene(card={"type": "rectangle", "id": "card", "bsdf": bsdf}))
    ((level, text),) = logged
    assert level == mi.LogLevel.Warn and "'card'" in text and "into each BSDF of the blendbsdf" in text
    mean, _ = quarters((good, WHOLE, MIRROR, MIRROR), -1, {"type": "constant", "radiance": 1.0}, samples=8)
    assert mean[0] == pytest.approx(0.6 * mean[1] + 0.4, abs=0.02)
    assert len(logged) == 1
