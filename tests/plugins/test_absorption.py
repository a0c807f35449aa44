"""Beer's law along what a ray goes through: against its formula, and against Mitsuba's ``volpath``."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from image_statistics import renderings, same_expectation
from mitsuba_prosim.compat import to_world_name
from mitsuba_prosim.transport.absorption import absorbs_any, media_of
from scenes import T, area, camera, diffuse, film, rectangle, rgb, sphere_lamp, without

#: Absorption by unit of length, as the tests have it.
SIGMA = np.array([1.0, 2.0, 0.5])

#: Glass that is seen by what it absorbs alone, and glass.
UNSEEN, GLASS = ({"type": "prosim_dielectric", "int_ior": n, "ext_ior": 1.0} for n in (1.0, 1.5))


def medium(*sigma, **more):
    return {"type": "homogeneous", "albedo": 0.0, "sigma_t": rgb(*(s / 10 for s in sigma)), "scale": 10.0, **more}


def reference(name):
    return {"type": "ref", "id": name}


def looking(at, **things):
    """A ray along -z through (``at``, 0), towards a lamp of radiance 1 behind all else."""
    place = T().look_at([at, 0, 9], [at, 0, 0], [0, 1, 0]).scale(1e-5)
    return {
        "type": "scene",
        "integrator": {"type": "prosim", "adaptive": "none", "max_level": 6},
        "sensor": {"type": "orthographic", "to_world": place, "film": film(1)},
        "lamp": rectangle(T().translate([0, 0, -9]).scale(20), **area()),
        **things,
    }


def slab(bsdf, **others):
    return {"type": "cube", "to_world": T().scale([4, 4, 0.5]), "bsdf": bsdf, "interior": medium(*SIGMA), **others}


def ball(bsdf):
    return {"type": "sphere", "bsdf": bsdf, "interior": medium(*SIGMA)}


def seen(scene, spp=4, **integrator):
    scene["integrator"] = scene["integrator"] | integrator
    return np.array(mi.render(mi.load_dict(scene), spp=spp))[0, 0, :3]


def between_two_faces(t):
    """What goes through two faces of index 1.5 at normal incidence, and whatever is reflected between them: ``t`` is
    the transmittance from one to the other.
    """
    r = 0.04
    return (1 - r) ** 2 * t / (1 - r * r * t * t)


@pytest.mark.parametrize("variant_name", ["llvm_ad_rgb", "scalar_rgb"])
@pytest.mark.parametrize("bounces", [0, -1])
def test_beers_law_in_a_slab_and_a_ball(variant_name, bounces):
    mi.set_variant(variant_name)
    mode = {"diffuse_bounces": bounces}
    assert seen(looking(0.0, it=slab(UNSEEN)), **mode) == pytest.approx(np.exp(-SIGMA), abs=1e-5)
    assert seen(looking(0.6, it=ball(UNSEEN)), **mode) == pytest.approx(np.exp(-1.6 * SIGMA), abs=5e-5)
    if bounces == 0:  # paths take one of the two ways at a face
        assert seen(looking(0.0, it=slab(GLASS))) == pytest.approx(between_two_faces(np.exp(-SIGMA)), abs=1e-5)
        assert seen(looking(0.0, it=ball(GLASS))) == pytest.approx(between_two_faces(np.exp(-2 * SIGMA)), abs=1e-5)


def test_the_length_is_exact_far_from_the_origin(variant_rgb):
    """Rays begin at some distance from the surface that they leave, which grows with its coordinates."""
    thin = slab(UNSEEN, to_world=T().translate([0, 0, -800]).scale([4, 4, 0.5]))
    scene = looking(0.0, it=thin)
    scene["lamp"]["to_world"] = T().translate([0, 0, -900]).scale(20)
    assert seen(scene) == pytest.approx(np.exp(-SIGMA), rel=1e-4)


def test_nested_media(variant_rgb):
    """A ball of one medium in a slab of another, and one in which nothing absorbs."""
    for inner, sigma in ((medium(0.2, 0.1, 3.0), np.array([0.2, 0.1, 3.0])), (medium(0.0, 0.0, 0.0), 0)):
        outside = reference("outside")
        within = {"type": "sphere", "radius": 0.5, "bsdf": UNSEEN, "interior": inner, "exterior": outside}
        things = {"it": slab(UNSEEN, interior=outside), "within": within}
        scene = looking(0.3, outside=medium(*SIGMA, id="outside"), **things)
        expected = np.exp(-(1 - 0.8) * SIGMA - 0.8 * sigma)
        assert seen(scene) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("told", [True, False])
def test_a_sensor_within_a_medium(variant_rgb, told):
    """The sensor's medium counts, and without one what the first surface says of its inside."""
    scene = looking(0.0, inside=medium(*SIGMA, id="inside"), it=slab(UNSEEN, interior=reference("inside")))
    scene["sensor"]["to_world"] = T().look_at([0, 0, 0.25], [0, 0, 0], [0, 1, 0]).scale(1e-5)
    scene["sensor"]["near_clip"] = 1e-4
    if told:
        scene["sensor"]["medium"] = reference("inside")
    assert seen(scene) == pytest.approx(np.exp(-0.75 * SIGMA), rel=2e-4)


def test_light_within_a_medium_is_absorbed_on_its_way_to_what_it_lights(variant_rgb):
    """A point lamp in a ball lights a card there: the shadow ray goes through the medium, and so does the camera's."""
    card = rectangle(T().translate([0, 0, -0.5]).scale(0.2), bsdf=diffuse(0.5, 0.5, 0.5))
    point = {"type": "point", "position": [0, 0.3, 0.0], "intensity": 1.0}
    scene = looking(0.0, it=slab(UNSEEN, to_world=T().scale(1)), card=card, point=point)
    d = np.hypot(0.3, 0.5)
    expected = 0.5 / np.pi * (0.5 / d) / d**2 * np.exp(-SIGMA * (d + 1.5))
    assert seen(without(scene, "lamp")) == pytest.approx(expected, rel=1e-3)


def test_media_of_instances(variant_rgb):
    scene = looking(
        0.0,
        group={"type": "shapegroup", "it": slab(UNSEEN)},
        copy={"type": "instance", "to_world": T().translate([0, 0, 1]), "group": reference("group")},
    )
    assert len(list(media_of(mi.load_dict(scene)))) == 1
    assert seen(scene) == pytest.approx(np.exp(-SIGMA), abs=1e-5)


def test_a_scattering_medium_is_ignored_with_a_warning(variant_rgb, logged):
    """One beside a medium that absorbs, which counts."""
    fog = medium(*SIGMA, id="fog") | {"albedo": rgb(0.0, 0.0, 0.4)}
    behind = slab(UNSEEN, to_world=T().translate([0, 0, -3]).scale([4, 4, 0.5]), interior=fog)
    assert seen(looking(0.0, behind=behind)) == pytest.approx(1)
    ((_, text),) = logged
    assert "fog" in text and "albedo" in text
    assert not absorbs_any(mi.load_dict(looking(0.0, behind=behind)), None)
    assert seen(looking(0.0, it=slab(UNSEEN), behind=behind)) == pytest.approx(np.exp(-SIGMA), abs=1e-5)


@pytest.mark.slow
def test_derivatives_by_absorption_and_thickness(variant_rgb):
    """exp(-s t) has the derivatives -t exp(-s t) and -s exp(-s t)."""
    scene = looking(0.0, it=ball(UNSEEN))
    scene["integrator"] |= {"diffuse_bounces": -1, "max_level": 2}
    scene = mi.load_dict(scene)
    params = mi.traverse(scene)
    sigma, to_world = "it.interior_medium.sigma_t.value.value", to_world_name(params, "it.")
    before = mi.Color3f(params[sigma])
    left = np.exp(-2 * SIGMA)

    grown, sigmas = mi.Float(0), mi.Color3f(before)
    dr.enable_grad(grown, sigmas)
    params[sigma], params[to_world] = sigmas, mi.Transform4f().scale(1 + grown)
    params.update()
    dr.backward(dr.sum(mi.render(scene, params, spp=4), axis=None))
    assert np.ravel(dr.grad(sigmas)) == pytest.approx(-20 * left, abs=1e-3)
    assert dr.grad(grown)[0] == pytest.approx(np.sum(-2 * SIGMA * left), abs=1e-3)


def test_the_features_of_a_denoiser_are_tinted(variant_rgb):
    scene = looking(0.0, it=slab(UNSEEN), integrator={"type": "prosim_features"})
    assert seen(scene) == pytest.approx(np.exp(-SIGMA), rel=1e-3)


@pytest.mark.slow
def test_same_expectation_as_volpath(variant_rgb):
    """Nested media, a lamp and a dull ball within, rough glass beside them: as ``volpath`` renders them."""
    air, green = {"type": "dielectric", "int_ior": 1.0, "ext_ior": 1.5}, reference("green")
    bubble = {"bsdf": air, "interior": medium(2, 0.1, 0.1), "exterior": green}
    rough = {"bsdf": {"type": "roughdielectric", "alpha": 0.2}, "interior": medium(0.1, 2, 2)}
    scene = {
        "type": "scene",
        "sensor": camera([0, 1, 6], [0, 0, 0], film(24), fov=28),
        "green": medium(0.9, 0.2, 1.2, id="green"),
        "outer": {"type": "sphere", "radius": 1.3, "bsdf": GLASS, "interior": green},
        "bubble": {"type": "sphere", "center": [-0.6, 0, 0.3], "radius": 0.4, **bubble},
        "dull": {"type": "sphere", "center": [0.5, -0.3, 0.2], "radius": 0.4, "bsdf": {"type": "diffuse"}},
        "lamp": sphere_lamp([0.2, 0.7, 0.4], 0.2, 3.0),
        "rough": {"type": "cube", "to_world": T().translate([1.6, -1, 0.2]).scale(0.5), **rough},
        "floor": rectangle(T().translate([0, 0, -2]).scale(6), bsdf={"type": "diffuse"}),
        "sky": {"type": "constant", "radiance": 0.7},
    }
    volpath = renderings(scene, 8, spp=100, type="volpath", max_depth=12, rr_depth=100)
    mode = {"adaptive": "none", "diffuse_bounces": -1, "max_level": 10, "rr_depth": 100}
    assert same_expectation(volpath, renderings(scene, 8, spp=100, type="prosim", **mode))
