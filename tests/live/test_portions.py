"""How long portions are of an image that somebody looks at, and how often it is drawn."""

from functools import partial
from types import SimpleNamespace

import drjit as dr
import pytest
from mitsuba_prosim.watch import due, portions
from mitsuba_prosim.watch.due import Due
from mitsuba_prosim.watch.portions import Growing


class Machine:
    """Takes so many samples in a second, and lets a clock go on; ``follow``: seconds that go before each portion."""

    def __init__(self, monkeypatch, samples, follow=lambda k: 0.0, at_once=False):
        self.time, self.samples, self.follow, self.at_once, self.lengths = 0.0, samples, follow, at_once, []
        monkeypatch.setattr(portions, "clock", lambda: self.time)
        monkeypatch.setattr(portions, "at_once", lambda: at_once)
        monkeypatch.setattr(dr, "sync_thread", self.wait)
        self.growing = Growing()

    def wait(self):
        self.time += 0.0 if self.at_once else self.lengths[-1]

    def take(self, samples):
        self.time += self.follow(len(self.lengths)) + (samples / self.samples if self.at_once else 0.0)
        self.lengths.append(samples / self.samples)

    def run(self, count, pause=0.0):
        """The lengths of so many portions in seconds, with a pause after each."""
        bounds = (self.growing.bound(None, 10**9) for _ in range(count))
        asked = (SimpleNamespace(work=samples, take=partial(self.take, samples)) for samples in bounds)
        for _ in self.growing(asked, lambda: False, False):
            self.time += pause
        return self.lengths


@pytest.mark.parametrize("pause", [0.0, 10.0])
def test_portions_grow_with_the_time_but_for_the_kernels(variant_rgb, monkeypatch, pause):
    """The first one compiles, the others are followed in 0.01 s; somebody looks at each for a while."""
    machine = Machine(monkeypatch, 1e6, lambda k: 0.01 if k else 5.0)
    lengths = machine.run(8, pause)
    assert lengths[1] <= 2 * lengths[0] and lengths[1] <= portions.LONG
    assert all(abs(length - portions.LONGEST) < 0.01 for length in lengths[3:])
    assert machine.growing.bound(1000, 10**9) == 1000
    # What is left is no portion of its own where it is little.
    most = machine.growing.bound(None, 10**9)
    assert machine.growing.bound(None, 6 * most // 5) == 6 * most // 5 and machine.growing.bound(None, 2 * most) == most


def test_short_ones_where_something_else_may_be_wished_at_once(variant_rgb, monkeypatch):
    lengths = Machine(monkeypatch, 1e7).run(12)
    assert lengths[0] <= lengths[1] <= 2 * portions.SHORTEST
    assert abs(lengths[-1] - portions.LONGEST) < 0.01 and sum(lengths[:4]) < 4 * portions.LONGEST


def test_one_thread_follows_the_code_and_takes_the_samples(variant_rgb, monkeypatch):
    lengths = Machine(monkeypatch, 1e6, at_once=True).run(12)
    assert max(lengths[1:]) < 1.1 * portions.LONGEST < 1.2 * lengths[-1]


def test_pictures_are_drawn_as_often_as_they_are_cheap(monkeypatch):
    time = 0.0
    monkeypatch.setattr(due, "clock", lambda: time)
    another, drawn = Due(), []
    for took in (0.001, 0.06):
        while time < 60:
            if another:
                drawn.append(time)
                with another.drawing():
                    time += took
            time += 0.01
        rate = len(drawn) / 60
        assert 0.8 < max(rate * due.EVERY, rate * took / due.SHARE) <= 1
        time, another, drawn = 0.0, Due(), []
