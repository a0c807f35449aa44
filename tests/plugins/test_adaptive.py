"""The criteria that say which pixels need more samples (sections 4.2.1.1, 5.3.2)."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from mitsuba_prosim.engine.policies import Neighbours, error_of_neighbours


@pytest.mark.parametrize("shape", [(7, 9), (3, 3), (1, 6), (2, 1), (1, 1)])
def test_error_of_neighbours_is_that_of_the_pixels_around(variant_rgb, shape):
    """By NumPy: samples of the 5 x 5 pixels around, as far as there are, without the pixel itself."""
    rng, n = np.random.default_rng(1), 5
    samples = rng.random((*shape, n))
    height, width = shape
    rows, columns = np.indices(shape)
    expected = np.full(shape, np.inf)
    for y, x in np.ndindex(shape):
        apart = np.maximum(abs(rows - y), abs(columns - x))
        around = samples[(apart > 0) & (apart <= Neighbours.reach)]
        if around.size:
            expected[y, x] = np.sqrt(around.var() / n) / (2 * np.sqrt(around.mean() + 0.01))
    error = error_of_neighbours(
        mi.Float(samples.sum(2).ravel()),
        mi.Float((samples**2).sum(2).ravel()),
        mi.Float(n),
        dr.opaque(mi.UInt32, width),
        dr.opaque(mi.UInt32, height),
    )
    assert np.allclose(np.array(error), expected.ravel(), rtol=1e-4)
