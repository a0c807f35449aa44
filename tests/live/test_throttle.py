"""How often an image is drawn that somebody looks at."""

from mitsuba_prosim.live import throttle
from mitsuba_prosim.live.throttle import Throttle


def test_pictures_are_drawn_as_often_as_they_are_cheap(monkeypatch):
    time = 0.0
    monkeypatch.setattr(throttle, "clock", lambda: time)
    another, drawn = Throttle(), []
    for took in (0.001, 0.06):
        while time < 60:
            if another.due:
                drawn.append(time)
                with another.drawing():
                    time += took
            time += 0.01
        rate = len(drawn) / 60
        assert 0.8 < max(rate * throttle.INTERVAL, rate * took / throttle.SHARE) <= 1
        time, another, drawn = 0.0, Throttle(), []
