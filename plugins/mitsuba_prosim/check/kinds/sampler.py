"""Tests of a sampler."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from ..report import NOTE, OK, Report
from ..statistics import chi_squared, normal_p, rows
from ..subject import Subject

#: Number of pixels, each with one sample.
PIXELS = 2**16


def draw(sampler: Any, seed: int, dimensions: int = 6) -> np.ndarray:
    """Numbers of a sampler, shape (dimensions, n): three of next_1d(), and the rest of next_2d()."""
    sampler.seed(seed, PIXELS)
    ones = [rows(sampler.next_1d(), PIXELS) for _ in range(dimensions // 2)]
    return np.concatenate([*ones, *(rows(sampler.next_2d(), PIXELS) for _ in range(dimensions // 2))])


def test_numbers(subject: Subject, report: Report) -> None:
    """Numbers lie in [0, 1), are uniform in pairs, repeat with the seed, and change with it; clones continue alike."""
    sampler = subject.load()
    a, b, again = draw(sampler, 0), draw(sampler, 1), draw(sampler, 0)
    report.require("numbers lie in [0, 1)", (a >= 0) & (a < 1), "they do not")
    report.require("the same seed gives the same numbers", a == again, "it does not")
    report.require("another seed gives other numbers", [np.mean(a == b) < 0.01], "it does not")
    names = [f"next_1d() {i}" for i in range(3)] + [f"next_2d() {i}" for i in range(6)]
    numbers = np.concatenate([a, b[:1]])
    for i, first in enumerate(names):
        z = (a[i].mean() - 0.5) * np.sqrt(12 * PIXELS)
        report.add("numbers have the mean 0.5", statistic=f"{a[i].mean():.4f}", where=first, p_value=normal_p(z))
        for j in range(i):
            z = float(np.corrcoef(numbers[i], numbers[j])[0, 1]) * np.sqrt(PIXELS)
            verdict = OK if normal_p(z) > 1e-6 else NOTE  # strata of all pixels may depend on each other
            report.add("dimensions are independent", verdict, where=f"{names[j]}, {first}", p_value=normal_p(z))
        z = float(np.corrcoef(a[i], b[i])[0, 1]) * np.sqrt(PIXELS)
        report.add("seeds are independent", where=first, p_value=normal_p(z))
    clone = sampler.clone()
    report.equal("a clone continues alike", rows(clone.next_1d(), PIXELS), rows(sampler.next_1d(), PIXELS), worst=NOTE)


def test_uniform(subject: Subject, report: Report) -> None:
    """next_2d() is uniform in the unit square."""
    from mitsuba.chi2 import PlanarDomain

    sampler, box = subject.load(), mi.ScalarBoundingBox2f([0, 0], [1, 1])

    def sample(u: Any) -> Any:
        sampler.seed(3, u.shape[1])
        return sampler.next_2d()

    def density(p: Any) -> Any:
        return mi.Float(1) + 0 * p.x

    chi_squared(report, "next_2d() is uniform", "", sample, density, domain=PlanarDomain(box), dimensions=2)


TESTS = test_numbers, test_uniform
