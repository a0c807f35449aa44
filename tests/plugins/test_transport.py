"""Surfaces of every kind in the tree and along paths: BSDFs within BSDFs, such as have no separate lobes, the ambient
term.
"""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from image_statistics import renderings
from mitsuba_prosim.transport import lobes, workarounds
from scenes import FLAT, T, area, bitmap, camera, film, load_scene, rectangle, rgb, sphere_lamp, without
from scipy import stats

BLACK = {"type": "diffuse", "reflectance": 0.0}
PRINCIPLED = {"type": "principled", "base_color": 0.5, "roughness": 0.4}
LAMBERTIAN = {"type": "prosim_lambertian", "reflectance": 0.5}
MIRROR = {"type": "conductor"}
ROUGH = {"type": "roughconductor", "alpha": 0.3}

bounces = pytest.mark.parametrize("bounces", [0, 3, -1], ids=["tree", "paths by two rays", "paths"])


def card(bsdf, **others):
    """A card before the camera; a rough metal ball out of sight lets the scene have every kind of lobe."""
    return {
        "type": "scene",
        "sensor": camera([0, 0, 5], [0, 0, 0], film(8), fov=20),
        "card": {"type": "rectangle", "to_world": T().scale(3), "bsdf": bsdf},
        "ball": {"type": "sphere", "center": [90, 0, 0], "bsdf": {"type": "roughconductor"}},
        **others,
    }


def assert_as_path(scene, *bounces, spp=256, **settings):
    """By any of these numbers of ``diffuse_bounces`` the mean of the image is that of ``path``: Welch's test on the
    means of 6 images of each, significance 0.001.
    """

    def means(**integrator):
        return renderings(scene, 6, spp=spp, **integrator).mean((1, 2, 3))

    expected = means(type="path", max_depth=8)
    for number in bounces:
        found = means(type="prosim", adaptive="none", diffuse_bounces=number, **settings)
        if expected.std() < 1e-6 and found.std() < 1e-6:
            assert found.mean() == pytest.approx(expected.mean(), rel=1e-4), number
        else:
            assert stats.ttest_ind(expected, found, equal_var=False).pvalue > 1e-3, number


@pytest.mark.slow
@pytest.mark.parametrize(
    "bsdf",
    [
        {"type": "mask", "opacity": 0.25, "b": BLACK},
        {"type": "mask", "opacity": 0.75, "b": {"type": "prosim_composite", "int_ior": 4.0}},
        {"type": "thindielectric"},
    ],
    ids=["mask", "mask of composite", "thindielectric"],
)
def test_what_is_seen_through_is_counted_once(variant_rgb, bsdf):
    light = rectangle(T().translate([0, 0, -1]).scale(9), **area())
    scene = card(bsdf, sky={"type": "constant", "radiance": 0.5}, light=light)
    assert_as_path(scene, 0, 8, -1)


@pytest.mark.slow
@pytest.mark.parametrize(
    "bsdf",
    [
        PRINCIPLED,
        {"type": "mask", "opacity": 0.5, "b": PRINCIPLED},
        {"type": "blendbsdf", "weight": 0.5, "a": PRINCIPLED, "b": {"type": "diffuse"}},
        {"type": "hair", "eumelanin": 0.2},
    ],
    ids=["principled", "mask", "blendbsdf", "hair"],
)
def test_lobes_that_cannot_be_evaluated_separately_are_counted_once(variant_rgb, bsdf):
    scene = card(bsdf, sky={"type": "constant", "radiance": 0.5}, light=sphere_lamp([1.5, 1.5, 3.0], 0.3, 10.0))
    assert_as_path(scene, 0, 20, -1, spp=400, max_level=6)


def test_an_instance_looks_as_what_it_is_of(variant_scalar):
    """Also where the lobes cannot be told apart, of which the instance itself says nothing: none is counted thrice."""
    scene = card(PRINCIPLED, light=sphere_lamp([1.5, 1.5, 3], 0.3, 10.0), integrator={"type": "prosim"})
    instance = {"type": "instance", "shapegroup": {"type": "ref", "id": "group"}}
    of_it = without(scene, "card") | {"group": {"type": "shapegroup", "card": scene["card"]}, "card": instance}
    images = [np.array(mi.render(mi.load_dict(description), spp=4)) for description in (scene, of_it)]
    assert images[1].mean() == pytest.approx(images[0].mean(), rel=0.05)


def test_the_back_of_a_one_sided_surface_reflects_no_ambient_light(variant_rgb):
    for bsdf, expected in ((LAMBERTIAN, 0), ({"type": "twosided", "b": LAMBERTIAN}, 0.5)):
        scene = card(bsdf, integrator={"type": "prosim", "ambient": 1.0, "max_level": 0})
        scene["card"]["to_world"] = T().rotate([0, 1, 0], 180).scale(3)
        assert np.allclose(np.array(mi.render(mi.load_dict(scene), spp=4)), expected, atol=1e-5)


@pytest.mark.parametrize("sensor", ["perspective", "thinlens", "orthographic", "prosim_window"])
@pytest.mark.parametrize("hidden", [False, True])
def test_nothing_is_seen_beyond_far_clip(variant_rgb, sensor, hidden):
    """A wall at 5 is not seen with the far plane at 3, but at 7; nor behind a hidden lamp."""
    lens = {"aperture_radius": 0.01, "focus_distance": 5.0} if sensor == "thinlens" else {}
    lamp = {"lamp": rectangle(T().translate([0, 0, 4]), **area())} if hidden else {}

    def image(far):
        seen_by = camera([0, 0, 5], [0, 0, 0], film(4), near_clip=0.1, far_clip=far, **lens) | {"type": sensor}
        scene = load_scene(
            integrator={"type": "prosim", "ambient": 1.0, "max_level": 0, "hide_emitters": hidden},
            sensor=seen_by,
            wall=rectangle(T().scale(9), bsdf=LAMBERTIAN),
            **lamp,
        )
        return np.array(mi.render(scene, spp=4))

    assert np.all(image(3.0) == 0) and np.allclose(image(7.0), 0.5, atol=1e-5)


@pytest.mark.parametrize("light", [{}, {"light": {"type": "prosim_point"}}], ids=["no light", "a point"])
@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "scalar_rgb"])
def test_a_scene_without_surfaces_shows_its_background(monkeypatch, variant, light):
    """In the tree and along paths; Dr.Jit has nothing to dispatch to, unless the process holds another scene."""
    mi.set_variant(variant)
    monkeypatch.setattr("drjit.dispatch", lambda *args: pytest.fail("asks for a BSDF where there is none"))
    ours = {"type": "prosim", "ambient": rgb(1.0, 1.0, 1.0), "background": rgb(0.25, 0.5, 0.75)}
    empty = without(card(BLACK, **light), "card", "ball")
    for integrator in (ours, ours | {"max_level": -1, "diffuse_bounces": -1}, {"type": "prosim_adaptive", "of": ours}):
        image = np.array(mi.render(mi.load_dict(empty | {"integrator": integrator}), spp=4))[..., :3]
        assert np.allclose(image, [0.25, 0.5, 0.75], atol=1e-6)


# ------------------------------------------------------------------ mask and blendbsdf, whose lobes need care


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
    bsdfs = (
        masked(MIRROR),
        masked(masked(MIRROR), 0.7),
        blended(MIRROR, BLACK),
        blended(ROUGH | {"specular_reflectance": 0.0}, MIRROR, 0.6),
    )
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
    mixed = blended(MIRROR, PRINCIPLED, 0.6)
    bsdfs = (
        PRINCIPLED,
        blended(PRINCIPLED, MIRROR, 0.4),
        two_sided(mixed),
        masked(blended(PRINCIPLED, MIRROR, 0.6), 0.5),
    )
    mean, error = quarters(bsdfs, bounces, {"type": "constant", "radiance": 1.0})
    expected = mean[0] * np.array([1, 0.6, 0.6, 0.2]) + [0, 0.4, 0.4, 0.8]
    assert (error < 0.01).all()
    assert (np.abs(mean - expected) < 4 * np.hypot(error, error[0]) + 1e-5).all(), (mean, expected, error)


@pytest.mark.parametrize("other", [BLACK, PRINCIPLED], ids=["apart", "whole"])
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

    good = blended(bumped(PRINCIPLED), bumped(MIRROR), 0.4)
    for bsdf in (good, bumped(blended(BLACK, MIRROR)), two_sided(bumped(blended(PRINCIPLED, MIRROR)))):
        workarounds.warn_of_dim_lobes(load_scene(card={"type": "rectangle", "id": "card", "bsdf": bsdf}))
    ((level, text),) = logged
    assert level == mi.LogLevel.Warn and "'card'" in text and "into each BSDF of the blendbsdf" in text
    mean, _ = quarters((good, PRINCIPLED, MIRROR, MIRROR), -1, {"type": "constant", "radiance": 1.0}, samples=8)
    assert mean[0] == pytest.approx(0.6 * mean[1] + 0.4, abs=0.02)
    assert len(logged) == 1
