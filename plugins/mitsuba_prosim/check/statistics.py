"""Tests of samples: chi-squared by Mitsuba's own class, Welch's test, and Šidák's correction.

A test returns the fields of a :class:`.Result`, such as ``p_value``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .inputs import described

#: Samples, cells per side, and points per side of a cell, of a chi-squared test.
SAMPLES, CELLS, POINTS = 2**18, 51, (6, 24)

#: RMS relative difference of density and samples below which a significant difference does not count: Mitsuba's own
#: rational approximations reach it.
RELATIVE = 0.02


def sidak(significance: float, count: int) -> float:
    """Returns the significance of each of ``count`` independent tests that have ``significance`` together."""
    return -math.expm1(math.log1p(-significance) / count)


def normal_p(z: float) -> float:
    """Returns the probability of a deviation of ``z`` standard errors or more, to either side."""
    return math.erfc(abs(z) / math.sqrt(2))


def mean_is(values: np.ndarray, low: float, high: float) -> dict[str, Any]:
    """Tests the claim that a mean is between ``low`` and ``high``."""
    mean, error = float(values.mean()), max(float(values.std()) / values.size**0.5, 1e-6)
    return {"statistic": f"{mean:.4f}", "p_value": normal_p(max(0.0, low - mean, mean - high) / error)}


def welch(a: np.ndarray, b: np.ndarray, tolerance: float = 1e-4) -> dict[str, Any]:
    """Tests the claim that two large samples have the same mean, but for a relative ``tolerance`` (for rounding)."""
    error = math.sqrt(a.var(ddof=1) / a.size + b.var(ddof=1) / b.size)
    mean_a, mean_b = float(a.mean()), float(b.mean())
    beyond = max(0.0, abs(mean_a - mean_b) - tolerance * max(abs(mean_a), abs(mean_b)))
    p = normal_p(beyond / error) if error else float(beyond == 0)
    return {"statistic": f"{mean_a:.4g} and {mean_b:.4g}", "p_value": p}


def chi_squared(
    sample: Callable, pdf: Callable, dimensions: int = 3, end: float = 1.0, start: float = 0.0
) -> dict[str, Any]:
    """Tests the claim that samples have a density.

    ``sample`` maps ``dimensions`` uniform numbers to a result: three to a direction, two to a point of the unit square,
    one to a number from ``start`` to ``end``. It may also return a mask of valid results. ``pdf`` is the density. If
    the integral of ``pdf`` over the cells changes with finer steps, the lobe is too narrow for the cells.
    """
    from mitsuba.chi2 import ChiSquareTest, LineDomain, PlanarDomain, SphericalDomain

    square = mi.ScalarBoundingBox2f([0, 0], [1, 1])
    domain = (LineDomain([start, end]), PlanarDomain(square), SphericalDomain())[dimensions - 1]

    def sampled(u: Any) -> tuple[Any, Any]:
        found = sample(u)
        point, valid = found if isinstance(found, tuple) else (found, mi.Bool(True))
        point = dr.select(valid, point, 0.5)
        return mi.Vector1f(point) if dimensions == 1 else point, dr.select(valid, mi.Float(1), 0)

    def density(point: Any) -> Any:
        return pdf(point) + dr.zeros(mi.Float, dr.width(point))

    chi2 = ChiSquareTest(domain, sampled, density, dimensions, SAMPLES, CELLS, POINTS[0], seed=1)
    if (p := _p_value(chi2)) < 1e-3:
        coarse, chi2.ires, chi2.pdf, chi2.fail = chi2.pdf, POINTS[1], None, False
        p = _p_value(chi2)
        change, error = (float(dr.sum(dr.abs(chi2.pdf - v))[0] / SAMPLES) for v in (coarse, chi2.histogram))
        if p < 1e-3 and change > 0.3 * error and change > 2e-3:
            return {"verdict": "not tested", "statistic": "the lobe is narrower than the cells"}
    cells = [np.array(one).reshape(int(chi2.res[1]), -1) for one in (chi2.pdf, chi2.histogram)]
    p = 1.0 if p < 1e-3 and deviation(*cells) < RELATIVE else p
    masses = f"density {chi2.pdf_sum[0]:.4f}, samples {chi2.histogram_sum[0]:.4f}"
    if p < 1e-3:
        cell = np.unravel_index(np.abs(cells[1] - cells[0]).argmax(), cells[0].shape)[::-1]
        middle = chi2.bounds.min + (mi.ScalarPoint2f(cell) + 0.5) / chi2.res * chi2.bounds.extents()
        masses += f", most different {described({'at': domain.map_forward(mi.Point2f(middle))})}"
    return {"statistic": masses, "p_value": p}


def deviation(expected: np.ndarray, found: np.ndarray) -> float:
    """Returns the RMS relative difference of density and samples over the cells, without the noise of the samples."""
    full = expected > 5
    excess = (np.square(found - expected) / np.maximum(expected, 1e-9))[full].sum() - full.sum()
    lost = found[~full].sum() - expected[~full].sum()
    return float(np.sqrt(max(0.0, excess) / SAMPLES) + abs(lost) / SAMPLES)


def _p_value(chi2: Any) -> float:
    """Runs the test; returns its p-value, 0 for samples where the density is 0 and the like."""
    chi2.messages = ""
    chi2.run(0.01, quiet=True)
    if "degrees of freedom is too low" in chi2.messages:  # all samples lie in one cell: only the masses are compared
        return float(abs(float(chi2.pdf_sum[0] - chi2.histogram_sum[0])) < 0.02)
    return 0.0 if chi2.fail or not np.isfinite(chi2.p_value) else float(max(chi2.p_value, 0.0))
