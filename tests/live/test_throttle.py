"""How often an image is drawn that somebody looks at."""

from mitsuba_prosim.live import publisher
from mitsuba_prosim.live.publisher import Throttle


def test_pictures_are_drawn_as_often_as_they_are_cheap(monkeypatch):
    time = 0.0
    monkeypatch.setattr(publisher, "clock", lambda: time)
    another, drawn = Throttle(), []
    for took in (0.001, 0.06):
        while time < 60:
            if another.due:
                drawn.append(time)
                with another.drawing():
                    time += took
            time += 0.01
        rate = len(drawn) / 60
        assert 0.8 < max(rate * publisher.DRAW_INTERVAL, rate * took / publisher.DRAW_SHARE) <= 1
        time, another, drawn = 0.0, Throttle(), []
