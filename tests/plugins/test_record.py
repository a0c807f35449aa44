"""An image that is resumed, merged from parts, or sampled by others in any order is that of one run."""

import gc
import itertools
import pickle
import random

import mitsuba as mi
import numpy as np
import pytest
from mitsuba_prosim.alone import alone
from mitsuba_prosim.engine.checkpoint import put_together
from mitsuba_prosim.engine.tiles import Part, part_numbers
from mitsuba_prosim.parallel import worker
from scenes import COPPER, loaded

CROP = {"width": 96, "height": 90, "crop_offset_x": 17, "crop_offset_y": 11, "crop_width": 50, "crop_height": 40}


def copper(size=40, rfilter="gaussian", **settings):
    return loaded(COPPER, size, rfilter=rfilter, **{"aovs": "samples,error", **settings})


def finished(scene, **how):
    """The image, and how far it came."""
    render = scene.integrator().progressive(scene, seed=3, **how).run()
    assert render.finished
    return np.array(scene.sensors()[0].film().develop()), (render.reached.samples, str(render.reached.noise))


def checkpoints(scene, **how):
    """A checkpoint after each step, and the last."""
    render = scene.integrator().progressive(scene, seed=3, **how)
    return [*(render.checkpoint() for _ in render), render.checkpoint()]


# ------------------------------------------------------------------ going on

QUICK = {"noise": 0.002, "max_samples": 300, "size": 24, "band": 250}
PHOTONS = {"caustics": True, "caustic_photons": 1 << 10, "size": 8, "samples": 2}
RESUMED = [
    QUICK,
    PHOTONS | {"adaptive": "graded", "threshold": 1e-4, "max_samples": 30},
    *({"adaptive": name} for name in ("none", "thesis", "neighbours")),
    {"noise": 0.004, "noise_99": 0.01, "max_samples": 100, "rfilter": "box"},
    {"noise": 0.003, "adaptive": "neighbours", "max_samples": 100, "rfilter": "box"},
    {"film": CROP, "adaptive": "graded"},
]


@pytest.mark.slow
@pytest.mark.parametrize("settings", RESUMED, ids=str)
def test_a_resumed_render_has_the_same_bits(variant_rgb, settings):
    """Within the first wave, within a later one, while its noise is measured, and at the ends."""
    scene = copper(**{"band": 700, **settings})
    expected = finished(scene)
    found = checkpoints(scene)
    for share in (0.1, 0.6, 0.9) if settings is QUICK else (0, 0.4, 0.8, 1):
        begin = found[round(share * (len(found) - 1))]
        image, reached = finished(scene, begin=begin)
        assert np.array_equal(image, expected[0]) and reached == expected[1], share


@pytest.mark.slow
def test_a_checkpoint_is_resumed_with_another_limit(variant_rgb):
    """More samples of every pixel: the image is that of one run. Less noise: it is reached, by adding samples alone."""
    half = checkpoints(copper(size=24, adaptive="none", max_samples=10))[-1]
    more = copper(size=24, adaptive="none", max_samples=20)
    assert np.array_equal(finished(more, begin=half)[0], finished(more)[0])
    quick = checkpoints(copper(size=24, adaptive="neighbours"))[-1]
    image, (samples, noise) = finished(copper(size=24, noise=0.0015, adaptive="graded"), begin=quick)
    assert float(noise) <= 0.0015 and samples > np.mean(quick.pixels["count"])
    assert np.all(np.rint(image[..., -2]).ravel() >= quick.pixels["count"])


@pytest.mark.slow
def test_a_maximum_below_n_is_continued(variant_rgb):
    """The passes keep their N, which such a maximum lowers: they were refused as the samples of another image."""
    begin = None
    for most, expected in [(3, 3), (40, 40), (4, 40)]:
        scene = copper(size=8, adaptive="none", max_samples=most, aovs="samples")
        image, _ = finished(scene, begin=begin)
        assert np.all(np.rint(image[..., -1]) == expected)
        begin = checkpoints(scene, begin=begin)[-1]


def test_checkpoints_of_another_image_are_refused(variant_rgb):
    (*_, last) = checkpoints(copper(size=8))
    for settings, says in [
        ({"samples": 4}, "samples of a pass: 5 there, 4 here"),
        ({"size": 10}, "window"),
        ({"rfilter": "box"}, "reach of the filter: 2 there, 0 here"),
        ({"aovs": "d:depth"}, "channels"),
        ({"max_samples": 60}, "continue with adaptive = graded"),
        ({"caustics": True, "caustic_photons": 16}, "photons of a set: None there, 16 here"),
    ]:
        with pytest.raises(ValueError, match=says):
            finished(copper(**{"size": 8, **settings}), begin=last)


# ------------------------------------------------------------------ parts


@pytest.mark.parametrize("margin, most", [(0, 1.03), (2, 1.06), (6, 1.25)])
@pytest.mark.parametrize("of", [2, 3, 8, 16])
def test_parts_have_equal_shares_of_slow_pixels(of, margin, most):
    """A ball in the middle, each of whose pixels takes as long as ten others."""
    x, y = np.ogrid[:800, :600]
    cost = np.where((x - 410) ** 2 + (y - 320) ** 2 < 150**2, 10, 1)
    owned = part_numbers((0, 0, 800, 600), of, margin, x, y)
    costs = [cost[owned == number].sum() for number in range(1, of + 1)]
    assert sum(costs) == cost.sum() and max(costs) < most * np.mean(costs)


@pytest.mark.slow
@pytest.mark.parametrize("adaptive", ["neighbours", "none", "thesis", "graded"])
def test_any_number_of_parts_makes_the_image(variant_rgb, adaptive):
    """Also with a crop window, and with a sampled border."""
    for film, of, rfilter in [({}, 3, "box"), (CROP, 2, "gaussian"), ({"sample_border": True}, 2, "gaussian")]:
        scene = copper(28, rfilter=rfilter, adaptive=adaptive, film=film, max_level=1)
        parts = [checkpoints(scene, part=Part(number, of))[-1] for number in range(1, of + 1)]
        np.random.default_rng(1).shuffle(parts)
        assert np.array_equal(finished(scene, begin=put_together(parts))[0], finished(scene)[0]), of


# ------------------------------------------------------------------ by others


class Elsewhere:
    """Takes samples by what travels, in another copy of the scene, a few work items at a time, in any order."""

    def __init__(self, scene, most=3000, together=3):
        self.estimator = None
        self.scene, self.most, self.together = scene, most, together
        self.chance = random.Random(1)

    def limit(self, left, seconds):
        return self.chance.randint(1, self.most)

    def __call__(self, items):
        while some := list(itertools.islice(items, self.together)):
            yield None  # nothing yet
            for item in self.chance.sample(some, len(some)):
                item.store(self.take(item))
                yield item

    def take(self, item):
        if self.estimator is None:
            sensor = self.scene.sensors()[0]
            self.estimator = self.scene.integrator().estimator(self.scene, sensor)
        return pickle.loads(worker.timed_sums(self.estimator, worker.packed(item))[1])


def test_a_scene_that_is_read_meanwhile_does_not_let_the_collector_run():
    """Another thread that reads one disables the collector for its own reasons, and enables it in between."""
    gc.disable()
    with alone():
        gc.enable()
        assert gc.get_threshold()[0] == 0
    assert gc.isenabled() and gc.get_threshold()[0] > 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        {"noise": 0.004, "max_samples": 200},
        PHOTONS | {"noise": 1e-4, "max_samples": 8},
        *({"adaptive": name, "rfilter": "box"} for name in ("none", "neighbours")),
        *({"adaptive": name} for name in ("thesis", "graded")),
        {"noise": 0.006, "max_samples": 60},
        {"size": 10, "noise": 0.01, "max_samples": 60},
    ],
    ids=str,
)
def test_samples_that_were_taken_elsewhere(variant_rgb, settings):
    """With all policies; with noise and a second image, larger patterns, and a filter that reaches other pixels."""
    here, there = (copper(**{"size": 24, **settings}) for _ in "ab")
    expected, reached = finished(here)
    found, as_far = finished(here, executor=Elsewhere(there, most=2000 if "caustics" in settings else 10000))
    assert np.array_equal(found, expected) and as_far == reached


@pytest.mark.slow
def test_a_crop_is_a_matter_of_who_asks(variant_rgb):
    film = {"film": CROP, "adaptive": "graded", "samples": 2}
    here, there = copper(**film), copper(film={**CROP, "crop_offset_x": 0, "crop_width": 96})
    sensor = there.sensors()[0]
    params = mi.traverse(sensor)
    params["film.crop_offset"], params["film.crop_size"] = mi.ScalarPoint2u(0), mi.ScalarVector2u(96, 90)
    params.update()
    there.integrator().samples = 7  # nor are these
    assert np.array_equal(finished(here)[0], finished(here, executor=Elsewhere(there))[0])
