"""Surfaces of every kind in the tree and along paths: BSDFs within BSDFs, such as have no separate lobes, the ambient
term.
"""

import mitsuba as mi
import numpy as np
import pytest
from image_statistics import renderings
from scenes import T, area, camera, film, load_scene, rectangle, rgb, sphere_lamp, without
from scipy import stats

BLACK = {"type": "diffuse", "reflectance": 0.0}
PRINCIPLED = {"type": "principled", "base_color": {"type": "rgb", "value": 0.5}, "roughness": 0.4}
LAMBERTIAN = {"type": "prosim_lambertian", "reflectance": 0.5}


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
