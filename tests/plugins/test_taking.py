"""Whoever takes the samples, and in which portions and order they are given back, the image is the same."""

import gc
import itertools
import pickle
import random

import mitsuba as mi
import numpy as np
import pytest
from mitsuba_prosim.alone import alone
from mitsuba_prosim.parallel import worker
from scenes import slow
from test_record import CROP, copper


class Elsewhere:
    """Takes samples by what travels, in another copy of the scene, a few work items at a time, in any order."""

    photon_passes = None

    def __init__(self, scene, most=3000, together=3):
        self.estimator = None
        self.scene, self.most, self.together = scene, most, together
        self.chance = random.Random(1)

    def limit(self, left, seconds):
        return self.chance.randint(1, self.most)

    def __call__(self, items):
        while some := list(itertools.islice(items, self.together)):
            yield None  # nothing yet
            yield from [(item, self.take(item)) for item in self.chance.sample(some, len(some))]

    def take(self, item):
        if self.estimator is None:
            sensor = self.scene.sensors()[0]
            self.estimator = self.scene.integrator().estimator(self.scene, sensor)
        return pickle.loads(worker.timed_sums(self.estimator, worker.packed(item))[1])


def image(scene, executor=None):
    render = scene.integrator().progressive(scene, seed=3, executor=executor).run()
    return np.array(render.image()), (render.reached.samples, str(render.reached.noise))


def test_a_scene_that_is_read_meanwhile_does_not_let_the_collector_run():
    """Another thread that reads one disables the collector for its own reasons, and enables it in between."""
    gc.disable()
    with alone():
        gc.enable()
        assert gc.get_threshold()[0] == 0
    assert gc.isenabled() and gc.get_threshold()[0] > 0


@pytest.mark.parametrize(
    "settings",
    [
        {"noise": 0.004, "max_samples": 200},
        *slow({"adaptive": "none", "rfilter": "box"}, {"adaptive": "neighbours", "rfilter": "box"}),
        *slow({"adaptive": "thesis"}, {"adaptive": "graded"}),
        *slow({"noise": 0.006, "max_samples": 60}, {"size": 10, "noise": 0.01, "max_samples": 60}),
    ],
    ids=str,
)
def test_samples_that_were_taken_elsewhere(variant_rgb, settings):
    """With all policies; with noise and a second image, larger patterns, and a filter that reaches other pixels."""
    here, there = (copper(**{"size": 24, **settings}) for _ in "ab")
    expected, reached = image(here)
    found, as_far = image(here, Elsewhere(there, most=10000))
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
    assert np.array_equal(image(here)[0], image(here, Elsewhere(there))[0])
