"""The prosim integrator: the right image, the same image, adaptively, with derivatives (chapter 4, sections 5.3,
5.4).
"""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from image_statistics import renderings, same_expectation
from mitsuba_prosim.compat import MXCSR, denormals_rounded, to_world_name
from mitsuba_prosim.engine.camera import ray_sampler
from mitsuba_prosim.engine.derivatives import Derivatives
from mitsuba_prosim.engine.policies import POLICIES, Neighbours, error_of_neighbours
from mitsuba_prosim.engine.work import Executor, WorkItem, work_items
from mitsuba_prosim.scene import session
from scenes import (
    COPPER,
    CROP,
    T,
    alone,
    camera,
    film,
    in_threads,
    kernels,
    load_scene,
    mesh,
    penumbra,
    rectangle,
    rgb,
    slow,
    sphere_lamp,
    without,
)


def render(scene, seed=0, spp=0, **window):
    """The image of ``scene``; ``window``: sizes of the film."""
    scene["sensor"]["film"].update(window)
    return np.array(mi.render(mi.load_dict(scene), seed=seed, spp=spp))


# ------------------------------------------------------------------ the right image


@pytest.mark.slow
def test_diffuse_scene_equals_direct(variant_rgb):
    direct = renderings(penumbra(type="direct"), 16, spp=36)
    for adaptive in ("none", "neighbours"):
        ours = renderings(penumbra(type="prosim", adaptive=adaptive), 16, spp=36)
        assert same_expectation(direct, ours)


@pytest.mark.slow
@pytest.mark.parametrize("bounces", [0, -1, 2])
def test_russian_roulette_does_not_change_the_mean(variant_rgb, bounces):
    how = {"type": "prosim", "adaptive": "none", "samples": 8, "max_level": 3, "diffuse_bounces": bounces}
    scene = penumbra(**how) if bounces else alone({"type": "dielectric"}, **how)
    by_lot, every = (renderings(scene, 3, rr_throughput=part, **scene["integrator"]) for part in (0.8, 0.0))
    difference = (by_lot - every)[..., 1].mean(axis=0)
    within = difference != 0
    z = difference[within].mean() / (difference[within].std() / np.sqrt(within.sum()))
    assert within.sum() > 30 and abs(z) < 4.5
    usual = [{}, {"caustics": True}, {"diffuse_bounces": -1}]
    assert [mi.load_dict({"type": "prosim"} | how).rr_throughput for how in usual] == [0.0, 0.01, 0.2]


def test_full_sphere_on_a_diffuse_surface_has_no_variance(variant_rgb):
    """Projected solid angle: where nothing is in the way, one sample is the answer (4.2.2.1)."""
    scene = without(penumbra(type="prosim", adaptive="none"), "pole", "ball", "wall")
    scene["sensor"]["to_world"] = T().look_at([0, 3, 0.1], [0, 0, 0], [0, 1, 0])
    one, many = render(scene, spp=1), render(scene, spp=100, seed=1)
    # What is left is the change of the irradiance within a pixel.
    assert np.abs(one / many - 1).max() < 0.03
    cos = 3.5 / np.sqrt(3**2 + 3.5**2 + 3**2)
    irradiance = np.pi * 25 * 0.5**2 / (3**2 + 3.5**2 + 3**2) * cos
    assert np.allclose(many[16, 16], np.array([0.6, 0.6, 0.5]) / np.pi * irradiance, rtol=0.02)


# ------------------------------------------------------------------ its own terms


def test_background_is_seen_in_mirrors_but_lights_nothing(variant_rgb):
    scene = penumbra({"type": "conductor", "material": "none"}, type="prosim", background=rgb(0.1, 0.2, 0.3))
    image = render(without(scene, "light"))
    assert image[25, 3].max() == 0  # the floor
    assert np.abs(image[13, 20] - [0.1, 0.2, 0.3]).max() < 0.2 * 0.3 and image[13, 20].max() > 0


@pytest.mark.parametrize("ball, paths", [({"type": "conductor", "material": "none"}, 0), (None, -1)])
def test_only_the_camera_sees_the_background_in_place_of_a_hidden_sky(variant_rgb, ball, paths):
    settings = {"type": "prosim", "hide_emitters": True, "adaptive": "none", "diffuse_bounces": paths}
    dark, bright = (render(without(alone(ball, background=light, **settings), "light")) for light in (0.0, 2.0))
    assert np.array_equal(bright[13, 20], dark[13, 20]) and dark[13, 20].any()  # on the ball
    assert (bright[0, 0] - dark[0, 0] == 2).all()


def test_without_shadows_nothing_is_dark(variant_rgb):
    dark, bright = (render(penumbra(type="prosim", adaptive="none", shadows=s)) for s in (True, False))
    assert np.all(bright >= dark * 0.999) and bright.mean() > 1.02 * dark.mean()


def test_one_channel_has_the_values_that_it_has_with_others(variant_rgb):
    image, red = render(penumbra(type="prosim")), render(penumbra(type="prosim", channels="r"))
    assert np.array_equal(image[..., 0], red[..., 0]) and red[..., 1:].max() == 0


@pytest.mark.parametrize("nested", [{}, {"inner": {"type": "path"}}])
@pytest.mark.parametrize("name, within", [("scalar_rgb", False), ("llvm_ad_rgb", True)])
def test_omitted_channels_are_black_where_mitsuba_takes_the_samples(name, within, nested):
    mi.set_variant(name)
    ours = {"type": "prosim_adaptive" if nested else "prosim", **nested}

    def image(**parameters):
        inner = {**ours, **parameters}
        around = {"type": "prosim_adaptive", "aov": {"type": "aov", "aovs": "d:depth", "inner": inner}}
        integrator = around if within else inner
        scene = {**penumbra(type="path"), "integrator": integrator}
        scene["sensor"] = {**scene["sensor"], "film": film(4)}
        return np.array(mi.render(mi.load_dict(scene), spp=4))

    everything, red = image(), image(channels="r")
    assert np.array_equal(everything[..., 0], red[..., 0]) and red[..., 0].max() > 0 and red[..., 1:3].max() == 0
    assert np.array_equal(everything, image(channels="bgr"))


def test_channels_are_refused_where_only_the_film_knows_the_colours(variant_spectral):
    loaded = mi.load_dict(penumbra(type="prosim_adaptive", inner={"type": "prosim", "channels": "r"}))
    with pytest.raises(RuntimeError) as caught:
        list(loaded.integrator().progressive(loaded))
    error = caught.value
    while error.__cause__ or error.__context__:  # Dr.Jit's loops raise errors of their own
        error = error.__cause__ or error.__context__
    assert 'channels = "r" is for its own render' in str(error)


# ------------------------------------------------------------------ the same image, bit by bit


@pytest.mark.slow
@pytest.mark.parametrize(
    "spp, adaptive, rfilter",
    [(4, "none", "box"), (0, "neighbours", "gaussian"), (0, "variance", "box"), (0, "graded", "gaussian")],
)
def test_bands_crops_and_threads_do_not_change_a_bit(variant_rgb, spp, adaptive, rfilter, monkeypatch):
    def image(band=1 << 18, **window):
        scene = penumbra(COPPER, rfilter=rfilter, type="prosim", adaptive=adaptive, band=band)
        return render(scene, spp=spp, **{"width": 40, **window})

    whole = image()
    assert np.array_equal(whole, image(band=67)) and np.array_equal(whole, image(band=333))
    monkeypatch.setattr("mitsuba_prosim.engine.work.MOST_SUMS", 9000)
    for threads in (1, 2, 5):
        assert np.array_equal(whole[11:20, 7:27], in_threads(threads, image, **CROP))


def test_at_common_edges_of_triangles_other_rays_do_not_change_a_bit(variant_rgb):
    """From above, exactly on the ridge of a roof with one side in the shade."""
    positions = [(x, y, -abs(x)) for y in np.linspace(-1, 1, 101) for x in (-1, 0, 1)]
    faces = [face for k in range(300) if k % 3 < 2 for face in ((k, k + 1, k + 4), (k, k + 4, k + 3))]
    lamp = {"type": "point", "position": [-9, 0, 1]}
    scene = load_scene(lamp=lamp, roof=mesh(positions, faces, bsdf={"type": "diffuse"}), integrator={"type": "prosim"})

    def radiance(o, d):
        ray = mi.RayDifferential3f(mi.Point3f(o.T), dr.normalize(mi.Vector3f(d.T)))
        return np.array(scene.integrator().sample(scene, mi.load_dict({"type": "independent"}), ray)[0])[0]

    o, d = np.random.default_rng(0).uniform(-0.9, 0.9, (2, 32000, 3))
    o[::16], d[::16] = o[::16] * (0, 1, 0) + (0, 0, 3), d[::16] * (0, 1, 0) - (0, 0, 3)
    assert np.array_equal(radiance(o[::16], d[::16]), radiance(o, d)[::16])


@pytest.mark.slow
def test_second_render_compiles_no_kernel(variant_rgb):
    """Seeds, bands, passes and thresholds share their kernels."""

    def used(seed, **settings):
        return kernels(lambda: render(penumbra(COPPER, type="prosim", **settings), seed))

    first = used(1)
    assert used(2) <= first and used(3, threshold=0.001) <= first
    assert used(4, band=200) <= used(5, band=300)  # bands but the last wait for each other: by a kernel of their own


@pytest.mark.slow
def test_work_items_share_their_kernels(variant_rgb, monkeypatch):
    """Already in the first render of a scene, of which the first work item traces things that the later ones find."""
    compute, used = WorkItem.compute, []

    def recorded(item):
        sums = []
        used.append(kernels(lambda: sums.append(compute(item))))
        return sums[0]

    monkeypatch.setattr(WorkItem, "compute", recorded)
    monkeypatch.setattr(Executor, "limit", lambda *_: 1 << 30)  # which depends on the time
    lamp = {"type": "sphere", "center": [3, 3, 3], "radius": 0.3, "emitter": {"type": "area", "radiance": 5.0}}
    render(penumbra(COPPER, type="prosim", adaptive="none", band=300) | {"lamp": lamp})
    assert len(used) == 4 and all(one == used[0] for one in used)


@pytest.mark.parametrize("lack", [[4, 0, 0], [4, 4, 0], [1, 4, 2], [4] * 6, [0, 5000, 0, 0]])
def test_no_work_item_has_a_single_pixel(variant_rgb, monkeypatch, lack):
    """Dr.Jit compiles other kernels for arrays of one entry."""
    monkeypatch.setattr(Executor, "limit", lambda *_: 1)
    scene = penumbra(COPPER, type="prosim", adaptive="none")
    scene["sensor"]["film"].update(width=len(lack), height=1)
    scene = mi.load_dict(scene)
    image = scene.integrator().progressive(scene, scene.sensors()[0]).state
    items = list(work_items(image, image.plan, np.array(lack, np.uint32), Executor(), lambda: np.inf))
    sizes = [len(item.compute().count) for item in items]
    assert set(sizes) <= {2, 3} and sum(item.samples for item in items) == sum(lack)
    assert image.count.tolist() == lack


@pytest.mark.parametrize("sensor", ["perspective", *slow("thinlens", "prosim_window")])
def test_resolutions_share_their_kernels(variant_rgb, sensor):
    scene = penumbra(type="prosim")
    scene["sensor"] |= {"type": sensor} | ({"aperture_radius": 0.1} if sensor == "thinlens" else {})
    if sensor == "prosim_window":
        del scene["sensor"]["fov"]
    first, other = (kernels(lambda size=size: render(scene, **size)) for size in ({}, {"width": 40, "height": 29}))
    assert other <= first


def test_rays_are_those_of_the_perspective_camera(variant_rgb):
    """But for the rounding; with an off-centre view, that Mitsuba's own method would compile for each resolution."""
    aside = {"principal_point_offset_x": 0.2, "principal_point_offset_y": -0.1}
    sensor = mi.load_dict(camera([1, 2, 3], [0, 0.5, 0], film(30, 20), fov=50, near_clip=0.5, far_clip=90, **aside))
    position = mi.Point2f([0, 0.3, 1], [0, 0.8, 1])
    samplers = ray_sampler(sensor), sensor.sample_ray_differential
    ours, theirs = (sample(0.5, 0.5, position, mi.Point2f(0))[0] for sample in samplers)
    for name in "o", "d", "maxt", "time", "o_x", "o_y", "d_x", "d_y":
        assert dr.allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-5)
    assert ours.has_differentials


def test_seed_as_an_array(variant_rgb):
    scene = mi.load_dict(penumbra(type="prosim"))
    by_array = scene.integrator().render(scene, 0, seed=mi.UInt32(3))
    assert np.array_equal(np.array(by_array), np.array(mi.render(scene, seed=3)))


# ------------------------------------------------------------------ the sums


def environment_render(radiance, spp, rfilter="box", size=2):
    """A render of an environment and nothing else, with ``spp`` samples of each pixel."""
    pixels = film(size, pixel_format="rgb", component_format="float32") | {"rfilter": {"type": rfilter}}
    scene = load_scene(
        integrator={"type": "prosim_adaptive", "adaptive": "none", "nested": {"type": "direct"}},
        sensor=camera([0, 0, 4], [0, 0, 0], pixels, fov=60),
        environment={"type": "envmap", "bitmap": mi.Bitmap(np.float32(radiance)), "scale": 1.0},
    )
    return scene.integrator().progressive(scene, spp=spp).run()


def samples_of(render):
    """All samples of a one-pixel render: their red values, with 64 bits."""
    with dr.suspend_grad():
        return np.concatenate([np.float64(values[0]) for values, _ in Derivatives(render.state).samples()])


@pytest.mark.parametrize("rfilter", ["box", *slow("gaussian")])
def test_million_equal_samples_have_their_mean(variant_rgb, rfilter):
    """The rounding errors of sums of 32 bits add up to one percent of a mean of 0.1."""
    image = np.array(environment_render(np.full((4, 8, 3), 0.1), 1 << 20, rfilter, size=1).image())
    assert np.allclose(image, 0.1, rtol=1e-6, atol=0)


def test_noisy_samples_have_their_mean(variant_rgb):
    render = environment_render(np.random.default_rng(1).uniform(0, 1, (32, 64, 3)), 1 << 17, size=1)
    samples = samples_of(render)
    assert samples.std() > 0.1 and len(samples) == 1 << 17
    assert np.allclose(np.array(render.image())[..., 0], samples.mean(), rtol=1e-6, atol=0)


def test_error_of_a_bright_pixel_with_little_noise_is_right(variant_rgb):
    """The variance is 1e-11 of the square of the mean, which floats of 32 bits cannot tell from zero."""
    grey = 1000 + 0.01 * np.random.default_rng(1).uniform(0, 1, (32, 64, 1))
    render = environment_render(np.repeat(grey, 3, axis=2), 37, size=1)
    samples = samples_of(render)
    assert 0 < samples.std() < 0.01
    assert np.allclose(render.error(), samples.std(ddof=1) / 37**0.5, rtol=1e-2)


# ------------------------------------------------------------------ denormal numbers


def dark_mirrors(**integrator):
    """A sky of 1e38, seen by two mirrors of 1e-20: a product of the mirrors is a denormal number."""
    mirror = {"type": "conductor", "material": "none", "specular_reflectance": rgb(1e-20, 1.3e-20, 2e-20)}
    mirror = {"type": "twosided", "bsdf": mirror}
    pixels = film(128, pixel_format="rgb", component_format="float32")
    return {
        "type": "scene",
        "integrator": integrator,
        "sensor": camera([0, 1, 4], [0, 5, 0], pixels, fov=10),
        "before": rectangle(T().scale(6), bsdf=mirror),
        "behind": rectangle(T().translate([0, 0, 8]).scale(30), bsdf=mirror),
        "sky": {"type": "constant", "radiance": rgb(1e38, 1e38, 1e38)},
    }


DARK = {"prosim": {"max_level": 3}, "prosim_adaptive": {"nested": {"type": "path", "max_depth": 4}}}
WINDOW = {"crop_offset_x": 60, "crop_offset_y": 60, "crop_width": 4, "crop_height": 4}


@pytest.mark.slow
@pytest.mark.parametrize("name", DARK)
def test_denormal_numbers_are_the_same_with_any_number_of_threads(variant_rgb, name):
    """A kernel of one thread, and a kernel of few pixels, runs in the thread that launches it."""
    scene = dark_mirrors(type=name, **DARK[name])
    expected = render(scene, spp=16)
    for threads in 1, 2, 3, 16:
        with session.threads(threads):
            assert np.array_equal(render(scene, spp=16), expected), threads
    assert np.array_equal(render(scene, spp=16, **WINDOW), expected[60:64, 60:64])


def test_denormal_numbers_stay_outside_of_renders(variant_rgb):
    """The processor's setting is that of the user again, after an error too."""
    tiny = np.full(4, 1e-39, np.float32)

    @denormals_rounded()
    def fail():
        assert np.all((tiny * np.float32(0.5) > 0) == (MXCSR == 0))
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert np.all(tiny * np.float32(0.5) > 0)


# ------------------------------------------------------------------ adaptivity


@pytest.mark.parametrize("shape", [(7, 9), (3, 3), (1, 6), (2, 1), (1, 1)])
def test_error_of_neighbours_is_that_of_the_pixels_around(variant_rgb, shape):
    """By NumPy: samples of the 5 x 5 pixels around, as far as there are, without the pixel itself."""
    rng, n = np.random.default_rng(1), 5
    samples = rng.random((*shape, n))
    rows, columns = np.indices(shape)
    expected = np.full(shape, np.inf)
    for y, x in np.ndindex(shape):
        apart = np.maximum(abs(rows - y), abs(columns - x))
        around = samples[(apart > 0) & (apart <= Neighbours.reach)]
        if around.size:
            expected[y, x] = np.sqrt(around.var() / n) / (2 * np.sqrt(around.mean() + 0.01))
    with np.errstate(all="ignore"):
        error = error_of_neighbours(*(np.float32(values.sum(2)) for values in (samples, samples**2)), n)
    assert np.allclose(error, expected, rtol=1e-4)


@pytest.mark.parametrize("adaptive", ["neighbours", "thesis"])
def test_samples_go_where_they_are_needed(variant_rgb, adaptive):
    """N on the flat parts, more on edges and in penumbrae, never more than N²."""
    scene = penumbra(type="prosim", adaptive=adaptive, samples=5, aovs="samples")
    taken = np.rint(render(scene, width=64, height=64)[..., -1]).astype(int)
    assert set(np.unique(taken)) <= {5, 10, 15, 20, 25}
    assert 5 < taken.mean() < 15
    assert np.all(taken[-8:, :20] == 5)  # open floor
    assert taken[20:40, 13:16].mean() > 15  # the pole, two pixels wide


@pytest.mark.parametrize(
    "name, measure",  # of the samples of a pixel
    [("thesis", lambda x: x.std(ddof=1) / np.sqrt(x.size)), ("variance", lambda x: np.mean((x - x.mean()) ** 2))],
)
def test_policy_stops_at_the_measure_that_it_names(variant_rgb, name, measure):
    """Where the measure is the threshold but for 1 %, above and below; not before the first pass ends."""
    samples = np.random.default_rng(1).gamma(0.3, size=(200, 10))
    expected = np.array([measure(x) for x in samples])
    total, squares = samples.sum(1), (samples**2).sum(1)
    for least, threshold in (5, np.median(expected)), (11, np.median(expected)):
        stops = POLICIES[name](5, threshold, least, 25, 25).request(total, squares, np.full(200, 10)) == 10
        clear = np.abs(expected / threshold - 1) > 0.01
        assert np.array_equal(stops[clear], (expected <= threshold)[clear] & (least <= 10)) and clear.mean() > 0.9


@pytest.mark.slow
def test_threshold_and_limits(variant_rgb):
    def mean(**settings):
        return render(penumbra(type="prosim", aovs="samples", **settings))[..., -1].mean()

    assert mean(threshold=1e9) == 5 and mean(threshold=0.0) > 20
    assert mean(threshold=0.0) >= mean(threshold=0.003) > mean(threshold=0.03)
    assert mean(threshold=1e9, min_passes=2) == 10
    assert mean(threshold=0.0, max_samples=15) <= 15
    assert mean(adaptive="none", samples=3) == 9 and mean(adaptive="none", samples=10, max_samples=6) == 6
    assert mean(adaptive="none", max_samples=99) == 99


@pytest.mark.slow
def test_neighbours_have_no_bias_and_the_thesis_a_small_one(variant_rgb):
    """A pixel's own samples that decide bias it (Kirk and Arvo 1991): up, in the mean of this scene, by some 0.05 %.

    The mean of the image over 24 seeds, in standard errors; 3.5 is a two-sided significance of 0.001.
    """

    def mean(**settings):
        means = renderings(penumbra(size=64, type="prosim", **settings), 24).mean((1, 2, 3))
        return means.mean(), means.std(ddof=1) / np.sqrt(len(means))

    truth, truth_error = mean(adaptive="none", samples=8)
    neighbours, neighbours_error = mean(adaptive="neighbours", samples=4)
    thesis, thesis_error = mean(adaptive="thesis", samples=4, threshold=0.006)
    assert abs(neighbours - truth) < 3.5 * np.hypot(truth_error, neighbours_error)
    assert abs(thesis - truth) > 3.5 * np.hypot(truth_error, thesis_error)
    assert abs(thesis / truth - 1) < 0.01


# ------------------------------------------------------------------ variants and ways to render


@pytest.mark.slow
def test_spectral_and_mono(variant_rgb):
    for variant in ("llvm_ad_spectral", "llvm_ad_mono"):
        mi.set_variant(variant)
        direct = renderings(penumbra(type="direct"), 12, spp=64)
        assert same_expectation(direct, renderings(penumbra(type="prosim", adaptive="none"), 12, spp=64))


def test_develop_false_leaves_the_film(variant_rgb):
    scene = mi.load_dict(penumbra(type="prosim"))
    expected = np.array(mi.render(scene, seed=4))
    scene.integrator().render(scene, seed=4, develop=False)
    film = scene.sensors()[0].film()
    assert np.array_equal(np.array(film.develop()), expected)
    assert np.allclose(np.array(film.bitmap()), expected, atol=1e-6)


@pytest.mark.slow
def test_several_sensors_and_specfilm(variant_spectral):
    scene = penumbra(type="prosim")
    low = {"type": "spectrum", "value": [(360, 1.0), (530, 0.0)]}
    high = {"type": "spectrum", "value": [(530, 0.0), (800, 1.0)]}
    scene["second"] = {**scene["sensor"], "film": film(24, 16, low=low, high=high) | {"type": "specfilm"}}
    loaded = mi.load_dict(scene)
    first, second = np.array(mi.render(loaded, sensor=0)), np.array(mi.render(loaded, sensor=1))
    assert first.shape == (32, 32, 3) and second.shape == (16, 24, 2) and second.mean() > 0


def test_noise_of_bands_beyond_visible_light_is_seen(variant_spectral):
    """Otherwise the first samples would be the last ones, though an error is asked for."""
    flat = {"type": "spectrum", "value": [(300, 0.6), (1100, 0.6)]}
    white = {"type": "diffuse", "reflectance": flat}
    band = {"type": "spectrum", "value": [(850, 0.1), (950, 0.1)]}
    scene = penumbra(white, 8, type="prosim", noise=0.01, samples=4)
    for name in "floor", "wall":
        scene[name] = scene[name] | {"bsdf": white}
    scene["light"] = sphere_lamp([-3, 3.5, 3], 0.5, {"type": "spectrum", "value": [(300, 9.0), (1100, 9.0)]})
    scene["sensor"] |= {"film": film(8, band=band) | {"type": "specfilm"}}
    loaded = mi.load_dict(scene)
    render = loaded.integrator().progressive(loaded).run()
    assert render.reached.noise <= 0.01 and render.reached.samples > 4 and render.error().max() > 0


@pytest.mark.parametrize(
    "variant_name, parameter",
    [
        ("llvm_ad_spectral", {"aovs": "samples"}),
        ("llvm_ad_spectral", {"aovs": "d:depth"}),
        ("llvm_ad_spectral", {"layers": "lights"}),
        ("scalar_spectral", {"aovs": "d:depth"}),
        ("llvm_ad_spectral", {"type": "prosim_features"}),
        ("llvm_ad_spectral", {"channels": "r"}),
    ],
)
def test_film_of_spectral_bands_refuses_aovs_layers_and_channels(variant_name, parameter):
    mi.set_variant(variant_name)
    scene = penumbra(**{"type": "prosim"} | parameter)
    bands = film(4, low={"type": "spectrum", "value": [(360, 1.0), (530, 0.0)]}) | {"type": "specfilm"}
    loaded = mi.load_dict({**scene, "sensor": {**scene["sensor"], "film": bands}})
    says = 'so channels = "r" cannot' if "channels" in parameter else "without AOVs and layers"
    with pytest.raises(ValueError, match=f"SpecFilm stores spectral bands, {says}"):
        loaded.integrator().render(loaded, spp=1)


def test_progress_and_cancel(variant_rgb):
    """What is cancelled leaves a whole image, and the next render is not cancelled."""
    scene = mi.load_dict(penumbra(type="prosim", band=128))
    integrator, film = scene.integrator(), scene.sensors()[0].film()
    done = [step.done for step in integrator.progressive(scene)]
    whole = np.array(film.develop())
    assert done == sorted(done) and len(done) > 8 and done[-1] == 1
    render = integrator.progressive(scene)
    for step in render:
        if step.done > 0.1:
            integrator.cancel()
    assert not render.finished and np.all((np.array(film.develop())[-8:] > 0).any(axis=2))
    assert np.array_equal(np.array(mi.render(scene)), whole)


def test_another_variant_between_two_steps_is_refused_and_the_first_continues(variant_rgb):
    scene = mi.load_dict(penumbra(type="prosim", band=128))
    render = scene.integrator().progressive(scene)
    next(render)
    mi.set_variant("scalar_rgb")
    for method in render.__next__, render.checkpoint:
        with pytest.raises(RuntimeError, match=f"began in the variant {variant_rgb}"):
            method()
    mi.set_variant(variant_rgb)
    assert np.array_equal(render.run().image(), mi.render(scene))


# ------------------------------------------------------------------ difficult scenes


def test_a_scene_without_light_or_with_light_in_a_closed_box_is_black(variant_rgb):
    box, room = ({"type": "cube", "to_world": T().translate([-3, 3.5, 3]).scale(size)} for size in (0.8, 30))
    dark = without(penumbra(COPPER, type="prosim"), "light")
    for scene in (penumbra(type="prosim") | {"box": box}, dark, dark | {"room": room, "sky": {"type": "constant"}}):
        assert np.array_equal(np.unique(render(scene)), [0])


def test_sources_may_change_between_renderings(variant_rgb):
    scene = mi.load_dict(penumbra(type="prosim", adaptive="none"))
    before = np.array(mi.render(scene))
    params = mi.traverse(scene)
    name = to_world_name(params, "light.")
    params[name] = params[name] @ mi.Transform4f().scale(2)
    params.update()
    assert np.array(mi.render(scene))[-4:].mean() == pytest.approx(4 * before[-4:].mean(), rel=0.05)
