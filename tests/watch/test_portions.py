"""How long portions are of an image that somebody looks at, and how often it is drawn."""

from types import SimpleNamespace

from mitsuba_prosim.watch import due, portions
from mitsuba_prosim.watch.due import Due
from mitsuba_prosim.watch.portions import Growing


def test_portions_grow_with_the_time_but_for_the_kernels(variant_rgb, monkeypatch):
    """At a million samples a second; the first portion compiles, the others are followed in 0.01 s."""
    time = 0.0
    monkeypatch.setattr(portions, "clock", lambda: time)
    growing, lengths = Growing(), []

    def taken(samples):
        def take():
            nonlocal time
            time += 0.01 if lengths else 5.0

        return SimpleNamespace(work=samples, take=take)

    def asked():
        while len(lengths) < 8:
            yield taken(growing.bound(None, 10**9))

    for portion, _ in growing(asked(), lambda: False, False):
        time += portion.work / 1e6
        lengths.append(portion.work / 1e6)
    assert lengths[1] <= 2 * lengths[0] and lengths[1] <= portions.LONG
    assert all(abs(length - portions.LONGEST) < 0.01 for length in lengths[3:])
    assert growing.bound(1000, 10**9) == 1000
    # What is left is no portion of its own where it is little.
    most = growing.bound(None, 10**9)
    assert growing.bound(None, 6 * most // 5) == 6 * most // 5 and growing.bound(None, 2 * most) == most


def test_short_ones_where_something_else_may_be_wished_at_once(variant_rgb, monkeypatch):
    time = 0.0
    monkeypatch.setattr(portions, "clock", lambda: time)
    growing, lengths = Growing(), []

    def asked():
        while len(lengths) < 12:
            yield SimpleNamespace(work=growing.bound(None, 10**9), take=lambda: None)

    for portion, _ in growing(asked(), lambda: False, False):
        time += portion.work / 1e7
        lengths.append(portion.work / 1e7)
    assert lengths[0] <= lengths[1] <= 2 * portions.SHORTEST
    assert abs(lengths[-1] - portions.LONGEST) < 0.01 and sum(lengths[:4]) < 4 * portions.LONGEST


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
