"""The sampling strategies that the thesis compares (section 4.2.1.2), for drawings and measurements.

Each function takes the number of samples ``n`` >= 1 and a ``numpy.random.Generator``, and returns an array (n, 2) of
points in [0, 1)². The renderer itself samples with :mod:`mitsuba_prosim.sampling.nrook`.
"""

import math

import numpy as np

#: Minimum distance of Poisson disk samples, times sqrt(n). Dart throwing does not end for about 0.83 or more.
SPACING = 0.72


def grid(n):
    """Lower corners (n, 2) of n square cells, row by row, and the number of cells along an axis.

    Raises ValueError if ``n`` is not a square; the thesis names this disadvantage of jittering.
    """
    side = math.isqrt(n)
    if n < 1 or side * side != n:
        raise ValueError(f"n is {n}; allowed: a square (1, 4, 9, 16, ...)")
    return np.stack(np.divmod(np.arange(n), side), axis=1) / side, side


def regular(n, rng):
    """The centres of n square cells; ``rng`` is not used. ``n`` must be a square."""
    corners, side = grid(n)
    return corners + 0.5 / side


def random(n, rng):
    """Independent, uniformly distributed samples (figure 4.2)."""
    return rng.random((n, 2))


def poisson_disk(n, rng):
    """Samples whose distances, on a torus, are at least SPACING / sqrt(n) (figure 4.3).

    The samples are found by dart throwing (Cook 1986): a candidate that is too near an earlier sample is rejected.
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
    """One random sample in each of n square cells, row by row (figure 4.4). ``n`` must be a square."""
    corners, side = grid(n)
    return corners + rng.random((n, 2)) / side


def uncorrelated_jittered(n, rng):
    """Jittered samples in random order (figure 4.6). ``n`` must be a square.

    So sample i of one space is combined with a random cell of another space.
    """
    return rng.permutation(jittered(n, rng))


def nrook(n, rng):
    """One sample in each of n rows and in each of n columns (figure 4.7), in random order; ``n`` is any number."""
    return (np.stack([rng.permutation(n), rng.permutation(n)], axis=1) + rng.random((n, 2))) / n


PATTERNS = {f.__name__: f for f in (regular, random, poisson_disk, jittered, uncorrelated_jittered, nrook)}
