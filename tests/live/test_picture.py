"""An image as the page receives it."""

import numpy as np
import pytest
from mitsuba_prosim.live.picture import Picture


@pytest.mark.parametrize("value, white", [(0, 0), (0.5, 0.5), (3e7, 3e7), (np.nan, 1)])
def test_layers_and_their_white(value, white):
    image = np.full((2, 4, 3), value, np.float32)
    content, facts = Picture(1, {"final": image}).packed("final")
    assert np.array_equal(np.frombuffer(content, "<f4").reshape(image.shape), np.nan_to_num(image))
    assert float(facts["X-White"]) == pytest.approx(white) and (facts["X-Width"], facts["X-Height"]) == ("4", "2")
