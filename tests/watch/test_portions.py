"""How often an image is drawn that somebody looks at."""

from mitsuba_prosim.watch import due
from mitsuba_prosim.watch.due import Due


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
