"""The sampling strategies of section 4.2.1.2: what defines each, and their variances."""

import numpy as np
import pytest
from drawing.patterns import SPACING, jittered, nrook, poisson_disk, random, regular, uncorrelated_jittered


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


def product(points):
    return np.prod(points - 0.5, axis=2)


def total(points):
    return points.sum(axis=2)


@pytest.mark.slow
@pytest.mark.parametrize(
    "pattern, f, expected, remainder",
    [
        (random, total, 1 / (6 * 16), 0),
        (jittered, total, 1 / (6 * 16**2), 0),
        (nrook, total, 1 / (6 * 16**3), 0),
        (random, product, 1 / (144 * 16), 0),
        (nrook, product, 1 / (144 * 15), 1 / 16**2),  # asymptotic in n: the remainder is relative
    ],
    ids=lambda x: getattr(x, "__name__", None),
)
def test_variance_of_sixteen_samples(pattern, f, expected, remainder):
    """Of x + y: N-rook wins by n², jittering by n. Of (x - 1/2)(y - 1/2): N-rook is no better than random.

    The sample variance of 20000 patterns lies within 4 standard errors (two-sided significance 6e-5).
    """
    rng = np.random.default_rng(5)
    square = f(np.array([pattern(16, rng) for _ in range(20000)])).mean(axis=1)
    square = (square - square.mean()) ** 2
    assert abs(square.mean() - expected) < 4 * square.std() / np.sqrt(len(square)) + remainder * expected
