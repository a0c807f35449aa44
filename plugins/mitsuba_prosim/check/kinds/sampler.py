"""Tests of a sampler."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from ..inputs import rows
from ..report import NOTE, OK, Report
from ..statistics import chi_squared, mean_is, normal_p
from ..subject import Subject

#: Number of pixels, each with one sample.
PIXELS = 2**16


def draw(sampler: Any, seed: int) -> np.ndarray:
    """Numbers of a sampler, shape (9, n): three of next_1d(), and three pairs of next_2d()."""
    sampler.seed(seed, PIXELS)
    return np.concatenate([rows(draw(), PIXELS) for draw in [sampler.next_1d] * 3 + [sampler.next_2d] * 3])


def test_numbers(subject: Subject, report: Report) -> None:
    """Numbers lie in [0, 1), have the mean 0.5, repeat with the seed, and change with it; clones continue alike."""
    sampler = subject.load()
    a, b, again = draw(sampler, 0), draw(sampler, 1), draw(sampler, 0)
    report.require("numbers lie in [0, 1)", (a >= 0) & (a < 1))
    report.require("the same seed gives the same numbers", a == again)
    report.require("another seed gives other numbers", [np.mean(a == b) < 0.01])
    correlated = np.corrcoef(a, b) * np.sqrt(PIXELS)
    for i in range(9):
        report.add("numbers have the mean 0.5", where=f"dimension {i}", **mean_is(a[i], 0.5, 0.5))
        report.add("seeds are independent", where=f"dimension {i}", p_value=normal_p(correlated[i, i + 9]))
        for j in range(i):
            p = normal_p(correlated[i, j])
            verdict = OK if p > 1e-6 else NOTE  # strata of all pixels may depend on each other
            report.add("dimensions are independent", verdict, where=f"{j}, {i}", p_value=p)
    clone = sampler.clone()
    report.equal("a clone continues alike", clone.next_1d(), sampler.next_1d(), worst=NOTE)


def test_uniform(subject: Subject, report: Report) -> None:
    """next_2d() is uniform in the unit square."""
    from mitsuba.chi2 import PlanarDomain

    sampler, square = subject.load(), PlanarDomain(mi.ScalarBoundingBox2f([0, 0], [1, 1]))

    def sample(u: Any) -> tuple[Any, Any]:
        sampler.seed(3, u.shape[1])
        return sampler.next_2d(), mi.Bool(True)

    chi_squared(report, "next_2d() is uniform", "", sample, lambda _: mi.Float(1), square, 2)


TESTS = test_numbers, test_uniform
