"""An image as the page gets it."""

import numpy as np
import pytest
from mitsuba_prosim.live.picture import Picture


@pytest.mark.parametrize("brightness", [1e-9, 0.7, 3e7])
def test_halves_hold_pictures_as_dark_or_bright_as_there_are(brightness):
    values = np.random.default_rng(0).uniform(0.1, 1, (8, 8, 3)).astype(np.float32) * np.float32(brightness)
    content, facts = Picture(1, {"final": values}).packed("final")
    halves = np.frombuffer(content, "<f2").reshape(values.shape)
    assert halves * np.float32(facts["X-Unit"]) == pytest.approx(values, rel=1e-3)


@pytest.mark.parametrize("image", [np.zeros((2, 2, 3)), np.full((2, 2, 3), np.nan)])
def test_what_is_black_or_no_number_has_a_unit_all_the_same(image):
    _, facts = Picture(1, {"final": image.astype(np.float32)}).packed("final")
    assert float(facts["X-Unit"]) == 1
