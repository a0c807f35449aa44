"""The choice of one lamp along paths: its probabilities, and the images that it makes."""

import functools

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from image_statistics import renderings, same_expectation
from mitsuba_prosim.light.light_sampler import LightSampler, lamp_models
from mitsuba_prosim.light.strategy import Receiver, SphereLights
from mitsuba_prosim.light.table import Lights
from scenes import (
    T,
    area,
    bitmap,
    camera,
    derivative,
    diffuse,
    film,
    ground,
    load_scene,
    penumbra,
    rectangle,
    rgb,
    sphere_lamp,
    without,
)


def checkered():
    texels = np.zeros((8, 8, 3))
    texels[:2, :2] = 40, 20, 10
    place = T().translate([3, 2, 0]).rotate([0, 1, 0], -90)
    return rectangle(place, **area(bitmap(texels, filter_type="nearest")))


def lamps(small=0):
    """Lamps of every kind, whose powers differ by a factor of 10,000; one is black, one is seen by no surface, one is
    behind the wall. ``small``: number of further ones.
    """
    beam = {"distribution": "cone", "angle": 12.0, "direction": [0, -1, -0.2]}
    result = {
        "strong": sphere_lamp([-3, 3.5, 3], 0.5, rgb(25, 25, 20)),
        "weak": sphere_lamp([0.5, 2.2, 1.0], 0.05, rgb(2, 1, 4)),
        "black": sphere_lamp([1.5, 2.2, 1.0], 0.1, rgb(0, 0, 0)),
        "behind": sphere_lamp([0, 2, -3], 0.4, rgb(30, 30, 30)),
        "panel": rectangle(T().translate([0, 5, 0]).rotate([1, 0, 0], 90), **area(rgb(5, 5, 5))),
        "textured": checkered(),
        "point": {"type": "point", "position": [2, 3, 2], "intensity": rgb(3, 1, 1)},
        "spot": {"type": "spot", "intensity": rgb(5, 5, 0), "to_world": T().look_at([0, 4, 2], [0, 0, 0], [0, 0, 1])},
        "beam": {"type": "prosim_point", "position": [-0.6, 3, 1.2], "intensity": 20.0} | beam,
        "even": {"type": "prosim_point", "position": [0, 9, 9], "intensity": 0.3, "unattenuated": True},
        "sun": {"type": "directional", "direction": [1, -1, -0.5], "irradiance": rgb(0.4, 0.3, 0.2)},
        "sky": {"type": "constant", "radiance": rgb(0.1, 0.1, 0.2)},
    }
    for i in range(small):
        place = [-2.5 + i % 6, 2.8, -1.5 + i // 6]
        result[f"small {i}"] = sphere_lamp(place, 0.04, rgb(3 * 1.3 ** (i % 12), 2, 2))
    return result


def lit(small=0, size=32, **integrator):
    """The penumbra's scene under these lamps."""
    return without(penumbra(size=size, **integrator), "light") | lamps(small)


def points(count):
    """Points about the scene as surfaces have them, facing all ways."""
    i = dr.arange(mi.UInt32, count)
    u = [mi.Float(i * k % 1009) / 1009 for k in (1, 17, 101, 331, 577)]
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.p = mi.Point3f(8 * u[0] - 4, 5 * u[1], 6 * u[2] - 2)
    n = mi.Normal3f(mi.warp.square_to_uniform_sphere(mi.Point2f(*u[3:])))
    si.n, si.sh_frame = n, mi.Frame3f(n)
    return si, n, i % 2 == 0


@pytest.mark.parametrize("unrolled, transmits", [(0, True), pytest.param(100, False, marks=pytest.mark.slow)])
def test_probabilities_sum_to_one_and_are_those_of_the_choice(variant_rgb, monkeypatch, unrolled, transmits):
    monkeypatch.setattr(LightSampler, "UNROLLED", unrolled)
    scene = mi.load_dict(lit(5))
    lights = Lights(scene, choose=True)
    sampler, active = lights.sampler, mi.Bool(True)
    si, n, both = points(200)
    both = both if transmits else False
    receiver = Receiver(si, n, both)
    each = [np.array(sampler.probability(mi.UInt32(k), receiver, active)) for k in range(lights.lamps)]
    # Also of those beside stronger ones: these may be hidden, which the choice does not know.
    assert np.min(each) > 0.33 / lights.lamps and np.max(each) > 0.5
    assert np.allclose(np.sum(each, 0), 1, atol=1e-5)
    # 4,096 evenly spaced numbers: each lamp has its share of them, in one piece, which is spread over [0, 1) again.
    point, steps = 7, 4096
    one = dr.gather(mi.SurfaceInteraction3f, si, mi.UInt32(point))
    u = (dr.arange(mi.Float, steps) + 0.5) / steps
    both = dr.gather(mi.Bool, both, mi.UInt32(point)) if transmits else False
    receiver = Receiver(one, dr.gather(mi.Normal3f, n, mi.UInt32(point)), both)
    k, probability, rest = (np.array(x) for x in sampler.choose(receiver, u, active))
    assert np.all(np.diff(k.astype(int)) >= 0)
    for number in range(lights.lamps):
        mine = k == number
        assert abs(mine.mean() - each[number][point]) <= 2 / steps
        assert np.allclose(probability[mine], each[number][point], rtol=1e-4)
        if mine.sum() > 100:
            assert abs(rest[mine].mean() - 0.5) < 0.02 and rest[mine].min() < 0.02 and rest[mine].max() > 0.98


FAR = {
    "sun": {"type": "directional", "direction": [0.3, -1, -0.3], "irradiance": 3.0},
    "sun as a ball": sphere_lamp([300, 900, 300], 10, 1e4),
    "point": {"type": "point", "position": [0, 1e4, 0], "intensity": 3e8},
}


@pytest.mark.slow
@pytest.mark.parametrize("far, half", [("sun", 1000), ("sun as a ball", 4), ("point", 4)])
def test_a_small_near_lamp_does_not_take_the_samples_of_a_far_one(variant_rgb, far, half):
    """The error of a render is at most half of that of ``path``; it was 3 to 22 times as great."""
    floor = {"floor": ground(half, diffuse(0.5, 0.5, 0.5)), "lamp": sphere_lamp([-1.5, 1, 1], 0.1, 30.0)}
    scene = load_scene(sensor=camera([0, 1.2, 6], [0, 0, 0], film(16)), far=FAR[far], **floor)
    path = mi.load_dict({"type": "path", "max_depth": 2})
    ours = mi.load_dict({"type": "prosim", "adaptive": "none", "max_level": 0, "diffuse_bounces": -1})
    expected = np.array(mi.render(scene, integrator=path, spp=1 << 14, seed=9))
    errors = [np.std(np.array(mi.render(scene, integrator=one, spp=64)) - expected) for one in (path, ours)]
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.slow
@pytest.mark.parametrize("bsdf", [diffuse(0.5, 0.5, 0.5), {"type": "roughconductor", "alpha": 0.4}])
def test_chosen_lamps_share_their_light_with_scattered_rays(variant_rgb, bsdf):
    """As for ``path``, with large lamps and a sun, within five standard errors (significance 1e-6)."""
    balls = {"near": sphere_lamp([0, 1.5, 0], 1.0, 3.0), "aside": sphere_lamp([3, 1.5, 1], 1.0, 3.0)}
    scene = load_scene(sensor=camera([0, 3, 6], [0, 0, 1], film(16)), floor=ground(4, bsdf), sun=FAR["sun"], **balls)
    path = {"type": "path", "max_depth": 2}
    ours = {"type": "prosim", "adaptive": "none", "max_level": 0, "diffuse_bounces": -1}
    images = [np.array(mi.render(scene, integrator=mi.load_dict(i), spp=1024))[..., 1] for i in (path, ours)]
    difference = images[1] - images[0]
    assert abs(difference.mean()) < 5 * difference.std() / 16 < 0.01 * images[0].mean()


def test_a_lamp_with_a_sampling_weight_of_0_is_off_where_no_ray_meets_it(variant_rgb):
    """As for Mitsuba's integrators."""
    lights = {"on": {"type": "point", "position": [0, 3, 0]}, "off": {"type": "point", "position": [1, 3, 0]}}
    pixel = {"floor": ground(3, diffuse(0.5, 0.5, 0.5)), "sensor": camera([0, 1.2, 6], [0, 0, 0], film(1), fov=1)}
    scenes = [load_scene(**pixel, on=lights["on"]), load_scene(**pixel, **lights)]
    params = mi.traverse(scenes[1])
    params["off.sampling_weight"] = 0.0
    params.update()
    for bounces in (0, -1):
        integrator = {"type": "prosim", "adaptive": "none", "diffuse_bounces": bounces}
        images = [mi.render(scene, integrator=mi.load_dict(integrator), spp=16) for scene in scenes]
        assert dr.allclose(*images) and np.mean(images[0]) > 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "small, hidden, ball",
    [(0, False, {"type": "roughdielectric", "alpha": 0.2}), (30, True, {"type": "roughconductor", "alpha": 0.1})],
    ids=["rough glass", "many and metal"],
)
def test_lamps_of_all_kinds_and_powers_equal_path(variant_rgb, small, hidden, ball):
    """Significance of each of two images: 0.01 (:func:`.image_statistics.same_expectation`)."""
    scene = lit(small, 16, ball=ball)
    path = renderings(scene, 12, spp=576, type="path", max_depth=4, hide_emitters=hidden)
    ours = {"type": "prosim", "adaptive": "none", "max_level": 2, "hide_emitters": hidden}
    for bounces in (-1, 20):
        assert same_expectation(path, renderings(scene, 12, spp=144, diffuse_bounces=bounces, **ours))


def test_no_kernel_grows_with_the_number_of_spheres(variant_rgb):
    """The kernel of a table of 3000 lamps was compiled for a minute."""
    scene = load_scene(**{f"lamp{k}": sphere_lamp([k, 0, 0], 0.1, 1) for k in range(300)})
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        table = SphereLights(scene.emitters()).table
        history = dr.kernel_history([dr.KernelType.JIT])
    assert max(kernel["operation_count"] for kernel in history) < 1500
    assert np.allclose(table[1], 0.1) and dr.width(table[1]) == 300


@pytest.mark.slow
def test_scalar_variants_choose_too():
    """One image of the mean radiance of that of a vectorised variant, within 5 standard errors of pixels."""
    settings = {"type": "prosim", "adaptive": "none", "max_level": 1, "diffuse_bounces": -1}
    images = []
    for variant, spp in (("llvm_ad_rgb", 256), ("scalar_rgb", 16)):
        mi.set_variant(variant)
        images.append(np.array(mi.render(mi.load_dict(lit(size=8, **settings)), spp=spp, seed=3)))
    difference = images[0] - images[1]
    assert abs(difference.mean()) < 5 * difference.std() / np.sqrt(difference.size)


def test_a_near_lamp_and_the_sky_compare_alike_in_all_variants():
    shares = []
    for variant in ("llvm_ad_rgb", "llvm_ad_spectral"):
        mi.set_variant(variant)
        lit_by = {name: lamps()[name] for name in ("point", "sky")}
        scene = mi.load_dict({"type": "scene", "floor": {"type": "rectangle"}} | lit_by)
        powers = lamp_models(scene, scene.emitters())[:, 4]
        shares.append(powers[1] / powers[0])
    assert shares[0] == pytest.approx(shares[1], rel=0.5)


@pytest.mark.slow
def test_derivatives_hold_the_choice_fixed(variant_rgb):
    """That of the mean of the image, by what is a factor of part of it: as large as the difference, within 4 standard
    errors of 6 images each.
    """
    scene = mi.load_dict(lit(size=16, type="prosim", adaptive="none", max_level=1, diffuse_bounces=-1))
    params, key = mi.traverse(scene), "panel.emitter.radiance.value"
    value, integrator = type(params[key])(params[key]), scene.integrator()

    def mean(factor, seed):
        params[key] = value * factor
        params.update()
        return dr.mean(mi.render(scene, params, integrator=integrator, spp=64, seed=seed), axis=None)

    # Light from the floor to the floor is of second order, and a central difference of 1.1 and 0.9 exact for it.
    differences = np.array([(mean(1.1, s).array[0] - mean(0.9, s + 50).array[0]) / 0.2 for s in range(6)])
    derivatives = [derivative(functools.partial(mean, seed=seed), 1) for seed in range(100, 106)]
    error = np.hypot(differences.std(ddof=1), np.std(derivatives, ddof=1)) / np.sqrt(6)
    assert abs(differences.mean() - np.mean(derivatives)) < 4 * error and np.mean(derivatives) > 4 * error
