import numpy as np
import pytest
from mitsuba_prosim.scene.images import compress


def test_an_image_within_range_stays():
    rgb = np.random.default_rng(1).uniform(0, 1, (20, 20, 3)).astype(np.float32)
    assert np.allclose(compress(rgb), rgb, atol=1e-6)


def test_highlights_fit_and_keep_order_and_colour():
    rgb = np.linspace(0, 8, 300, dtype=np.float32).reshape(20, 15, 1) * np.array([1, 0.5, 0.25], dtype=np.float32)
    shown = compress(rgb)
    luminance = shown @ [0.2126, 0.7152, 0.0722]
    assert np.all(np.diff(luminance.ravel()) > 0)
    assert np.percentile(luminance, 99) == pytest.approx(1, abs=0.01)
    assert np.allclose(shown[..., 1], shown[..., 0] / 2, atol=1e-6)
