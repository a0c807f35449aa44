"""Images as the page receives them, and how often."""

import numpy as np
import pytest
from mitsuba_prosim.live import progressive_image
from mitsuba_prosim.live.progressive_image import Picture


@pytest.mark.parametrize("value, white", [(0, 0), (0.5, 0.5), (3e7, 3e7), (np.nan, 1)])
def test_packed_layer_has_its_white(value, white):
    image = np.full((2, 4, 3), value, np.float32)
    content, facts = Picture(1, {"final": image}).packed("final")
    assert np.array_equal(np.frombuffer(content, "<f4").reshape(image.shape), np.nan_to_num(image))
    assert float(facts["X-White"]) == pytest.approx(white) and (facts["X-Width"], facts["X-Height"]) == ("4", "2")


def test_throttle_draws_cheap_pictures_often(monkeypatch):
    time = 0.0
    monkeypatch.setattr(progressive_image, "clock", lambda: time)
    another, drawn = progressive_image.Throttle(), []
    for took in (0.001, 0.06):
        while time < 60:
            if another.due:
                drawn.append(time)
                with another.drawing():
                    time += took
            time += 0.01
        rate = len(drawn) / 60
        assert 0.8 < max(rate * progressive_image.DRAW_INTERVAL, rate * took / progressive_image.DRAW_FRACTION) <= 1
        time, another, drawn = 0.0, progressive_image.Throttle(), []
