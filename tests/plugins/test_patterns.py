"""The sampling strategies of section 4.2.1.2: what defines each."""

import numpy as np
import pytest
from drawing.patterns import SPACING, jittered, nrook, poisson_disk, regular, uncorrelated_jittered


@pytest.mark.parametrize("pattern", [regular, jittered, uncorrelated_jittered], ids=lambda f: f.__name__)
def test_each_cell_is_hit_once(pattern):
    cells = np.floor(pattern(25, np.random.default_rng(2)) * 5).astype(int)
    assert sorted(map(tuple, cells)) == [(i, j) for i in range(5) for j in range(5)]


def test_nrook_has_one_sample_a_row_and_a_column():
    points = np.array([nrook(7, np.random.default_rng(seed)) for seed in range(50)])
    assert np.all(np.sort(np.floor(points * 7), axis=1) == np.arange(7)[:, None])
    assert len(np.unique(np.floor(points * 7), axis=0)) == 50  # and not the same ones each time


def test_poisson_disk_samples_keep_their_distance():
    points = poisson_disk(100, np.random.default_rng(3))
    apart = np.abs(points[:, None] - points)
    apart = np.hypot(*np.moveaxis(np.minimum(apart, 1 - apart), 2, 0)) + np.eye(100)
    assert SPACING / 10 <= apart.min() < 1.05 * SPACING / 10


def test_uncorrelated_jittering_associates_spaces_at_random():
    """Cells of equal index agree in two jittered spaces; uncorrelated ones correlate as random numbers do."""
    rng = np.random.default_rng(4)
    pairs = [(f(100, rng)[:, 0], f(100, rng)[:, 0]) for f in (jittered, uncorrelated_jittered)]
    same, mixed = (np.corrcoef(a, b)[0, 1] for a, b in pairs)
    assert same > 0.95 and abs(mixed) < 0.33  # 3.3 standard deviations of 1/sqrt(99)
