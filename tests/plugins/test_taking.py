"""Whoever takes the samples, and in which portions and order they are given back, the image is the same."""

import gc
import pickle
import random
from types import SimpleNamespace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from mitsuba_prosim.alone import alone
from mitsuba_prosim.cluster import fleet, message, worker
from mitsuba_prosim.cluster import sets as photon_sets
from mitsuba_prosim.cluster.desk import Desk, Ticket
from mitsuba_prosim.cluster.errand import Errand
from mitsuba_prosim.engine.estimate import Estimator
from scenes import penumbra
from test_record import CROP, loaded


class Elsewhere:
    """Takes samples by what was sent, in another copy of the scene, a few portions at a time; the answers come in any
    order.
    """

    sets = None

    def __init__(self, scene, most=3000, together=3, history=False):
        self.estimator = None
        self.scene, self.most, self.together, self.history = scene, most, together, history
        self.chance = random.Random(1)
        #: Kernels that were compiled, portion by portion.
        self.compiled = []

    def limit(self, most, left):
        return self.chance.randint(1, self.most)

    def __call__(self, items, ordered):
        desk = Desk((Errand.portion(item, "") for item in items), ordered)
        while True:
            tickets = [ticket for _ in range(self.together) if (ticket := desk.next(self.together))]
            if not tickets:
                assert not desk.left
                return
            self.chance.shuffle(tickets)
            yield None  # nothing yet
            for ticket in tickets:
                _, asked, sets = pickle.loads(pickle.dumps(ticket.errand.arguments))
                yield from desk.give(ticket, ticket.errand.read(self.answer(asked, sets)))

    def answer(self, asked, sets):
        plan, policy = worker.planned(asked["plan"])
        if self.estimator is None:
            sensor = self.scene.sensors()[0]
            self.estimator = self.scene.integrator().estimator(plan, self.scene, sensor)
        portion = message.portion(asked, plan, policy, self.estimator)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, self.history):
            more = portion.take()
            self.compiled.append(sum(not kernel.get("cache_hit", True) for kernel in dr.kernel_history()))
        return message.answer(more, asked["pixels"])


def image(scene, executor=None):
    render = scene.integrator().progressive(scene, seed=3, executor=executor).run()
    return np.array(render.image()), (render.reached.samples, str(render.reached.noise))


def taken_alike(settings, **how):
    here, there = loaded(**settings), loaded(**settings)
    expected, reached = image(here)
    found, as_far = image(here, Elsewhere(there, **how))
    assert np.array_equal(found, expected) and as_far == reached


def collecting():
    return gc.isenabled() and gc.get_threshold()[0] > 0


def test_samples_that_were_taken_elsewhere(variant_rgb, monkeypatch):
    """With noise, larger patterns, a second image, and a filter that reaches other pixels; nor does Python's garbage
    collector run meanwhile, which would free scenes that the kernels know.
    """
    take, collects = Estimator.take, set()
    monkeypatch.setattr(Estimator, "take", lambda *rest, **more: collects.add(collecting()) or take(*rest, **more))
    taken_alike({"size": 24, "noise": 0.004, "max_samples": 200}, most=20000)
    assert collects == {False} and collecting()


def test_a_scene_that_is_read_meanwhile_does_not_let_the_collector_run():
    """Another thread that reads one disables the collector for its own reasons, and enables it in between."""
    gc.disable()
    with alone():
        gc.enable()
        assert not collecting()
    assert collecting()


@pytest.mark.slow
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
@pytest.mark.parametrize(
    "settings",
    [
        {"adaptive": "none"},
        {"adaptive": "neighbours"},
        {"adaptive": "thesis"},
        {"adaptive": "graded"},
        {"adaptive": "graded", "kept": 0},
        {"noise": 0.006, "kept": 0, "max_samples": 60},
        {"size": 10, "noise": 0.01, "max_samples": 60},
    ],
    ids=str,
)
def test_samples_of_all_policies_and_filters(variant_rgb, monkeypatch, rfilter, settings):
    settings = dict(settings)
    monkeypatch.setattr("mitsuba_prosim.engine.state.KEPT", settings.pop("kept", 1 << 30))
    taken_alike({"size": 24, "rfilter": rfilter, **settings}, most=10000)


def test_a_second_portion_compiles_nothing(variant_rgb):
    """Whatever its pixels, their counts and sums, and where in memory the arrays are that it came in."""
    scene = loaded(24, adaptive="graded", samples=3)
    taker = Elsewhere(scene, history=True)
    dr.kernel_history_clear()
    image(loaded(24, adaptive="graded", samples=3), taker)
    assert len(taker.compiled) > 5 and not any(taker.compiled[1:])


@pytest.mark.slow
def test_a_crop_is_a_matter_of_who_asks(variant_rgb):
    film = {"film": CROP, "adaptive": "graded", "samples": 2}
    here, there = loaded(**film), loaded(film={**CROP, "crop_offset_x": 0, "crop_width": 96})
    sensor = there.sensors()[0]
    params = mi.traverse(sensor)
    params["film.crop_offset"], params["film.crop_size"] = mi.ScalarPoint2u(0), mi.ScalarVector2u(96, 90)
    params.update()
    there.integrator().samples = 7  # nor are these
    assert np.array_equal(image(here)[0], image(here, Elsewhere(there))[0])


def test_a_sampler_of_mitsubas_stays_where_it_is(variant_rgb):
    settings = {"type": "prosim_adaptive", "nested": {"type": "direct"}, "sampler": {"type": "independent"}}
    scene = mi.load_dict(penumbra(size=4, **settings))
    with pytest.raises(ValueError, match="nor shared out"):
        image(scene, Elsewhere(scene))


# ------------------------------------------------------------------ who is given what


def working(paces):
    """A fleet of workers of these paces, by names, and its clock, whose hand can be set."""
    now = [0.0]
    some = fleet.Fleet(lambda: now[0])
    for name, pace in paces.items():
        some.workers[name] = fleet.Worker(name, 1, pace, answers=2)
    return some, now


def give(some, name, number, work, taken_back=None):
    ticket = Ticket(number, Errand(None, (), work, None))
    some.give(ticket, some.workers[name], lambda: (taken_back if taken_back is not None else []).append(name))
    return ticket


def test_portions_are_as_large_as_a_worker_is_fast():
    some, _ = working({"fast": 3e6, "slow": 1e6, "new": 0.0})
    fast, slow, new = some.workers.values()
    assert some.bound(fast, None, 10**9) == 3 * some.bound(slow, None, 10**9) == 3e6 * fleet.LONGEST
    assert some.bound(new, None, 10**9) == fleet.FIRST
    assert some.bound(slow, 2 * 10**6, 10**9) == 4 * 10**5  # of all together
    assert some.bound(slow, 1, 10**9) == some.bound(slow, None, 1) == 1e6 * fleet.SHORTEST
    slow.learn(2 * 10**6, 0.5, 1.0)
    assert slow.pace == 1.5e6 and slow.seconds(3 * 10**6) == 2.25
    assert some.bound(slow, None, 1) == fleet.TIMES * 0.25 * 1.5e6  # what goes before it is a small part
    assert some.free() is fast
    give(some, "fast", 0, 1)
    assert some.free() is slow


def test_what_is_late_is_done_once_more_by_who_has_nothing_to_do():
    some, now = working({"a": 1e6, "b": 1e6})
    first, second = (give(some, "a", i, 2 * 10**6) for i in range(2))
    assert list(some.repeats()) == [(second, some.workers["b"])]  # it would begin with it after two seconds
    taken_back = []
    some.give(second, some.workers["b"], lambda: taken_back.append("b"))
    assert list(some.repeats()) == []
    some.take_back(second)  # one of them has answered
    assert taken_back == ["b"] and some.out() == [first]
    now[0] = 3.9
    assert list(some.repeats()) == []
    now[0] = 6.0  # two seconds' work that takes six: the worker may be stuck
    assert list(some.repeats()) == [(first, some.workers["b"])]
    assert some.remove("a") == [first] and some.out() == []


def test_workers_draw_photons_for_each_other():
    drawn, released = [], []

    def draw(errand, which, address):
        drawn.append((which[1], address))
        return SimpleNamespace(name=which[1], release=lambda: released.append(which[1]))

    def of(*numbers):
        needed = Errand(None, (), 1, None, sets=[(0, number, 16) for number in numbers])
        return [future.name for future in some.of(needed, ["a", "b"])]

    some = photon_sets.PhotonSets(draw)
    assert of(0, 1, 2) == [0, 1, 2] and of(1, 2) == [1, 2]
    assert drawn == [(0, "a"), (1, "b"), (2, "a")]  # as many each, and each once
    assert of(3, 4) == [3, 4] and released == [0]  # that used longest ago
    assert of(*range(photon_sets.KEPT + 1)) == [] and len(drawn) == 5  # who needs so many has no room for them
    assert some.lose("a") == {(0, number, 16) for number, address in drawn[1:] if address == "a"}
    assert of(2) == [2] and drawn[-1] == (2, "a") and released.count(2) == 1
    some.forget()
    assert sorted(released) == sorted(number for number, _ in drawn)
