"""The sampling strategies that the thesis compares (section 4.2.1.2), to draw and to measure.

Each function takes the number of samples ``n`` >= 1 and a ``numpy.random.Generator``, and returns an array (n, 2) of
points in [0, 1)². What the renderer samples with is :mod:`mitsuba_prosim.sampling.nrook`.
"""

import math

import numpy as np

#: Least distance of Poisson disk samples, times sqrt(n). Dart throwing gets stuck at about 0.83.
SPACING = 0.72


def grid(n):
    """Lower corners of n square cells, row by row, (n, 2), and their number along an axis.

    Raises ValueError if ``n`` is not a square: the disadvantage of jittering that the thesis names.
    """
    side = math.isqrt(n)
    if n < 1 or side * side != n:
        raise ValueError(f"n is {n}; allowed: a square (1, 4, 9, 16, ...)")
    return np.stack(np.divmod(np.arange(n), side), axis=1) / side, side


def regular(n, rng):
    """The centres of the cells; ``rng`` is not used. ``n``: a square."""
    corners, side = grid(n)
    return corners + 0.5 / side


def random(n, rng):
    """Independent, uniform (figure 4.2)."""
    return rng.random((n, 2))


def poisson_disk(n, rng):
    """No two samples closer than SPACING / sqrt(n), the square being closed to a torus (figure 4.3).

    By throwing darts (Cook 1986): what lands too near an earlier one is thrown away.
    """
    points = np.empty((0, 2))
    while len(points) < n:
        dart = rng.random(2)
        apart = np.abs(points - dart)
        apart = np.minimum(apart, 1 - apart)
        if np.all(np.sum(apart**2, axis=1) >= SPACING**2 / n):
            points = np.vstack([points, dart])
    return points


def jittered(n, rng):
    """One sample anywhere in each cell, row by row (figure 4.4). ``n``: a square."""
    corners, side = grid(n)
    return corners + rng.random((n, 2)) / side


def uncorrelated_jittered(n, rng):
    """The same in random order: sample i of one space meets any cell of another (figure 4.6). ``n``: a square."""
    return rng.permutation(jittered(n, rng))


def nrook(n, rng):
    """One sample in each of n rows and n columns (figure 4.7), in random order; any ``n``."""
    return (np.stack([rng.permutation(n), rng.permutation(n)], axis=1) + rng.random((n, 2))) / n


PATTERNS = {f.__name__: f for f in (regular, random, poisson_disk, jittered, uncorrelated_jittered, nrook)}
