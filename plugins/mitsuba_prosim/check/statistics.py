"""Tests of samples: chi-squared by Mitsuba's own class, Welch's test, and Šidák's correction."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

#: Samples, cells per side, and points per side of a cell, of a chi-squared test.
SAMPLES, CELLS, POINTS = 2**18, 51, (6, 24)

#: RMS relative difference of density and samples below which a significant difference is a note: Mitsuba's own rational
#: approximations reach it.
RELATIVE = 0.03


def sidak(significance: float, count: int) -> float:
    """Returns the significance of each of ``count`` independent tests that have ``significance`` together."""
    return -math.expm1(math.log1p(-significance) / count)


def normal_p(z: float) -> float:
    """Returns the probability of a deviation of ``z`` standard errors or more, to either side."""
    return math.erfc(abs(z) / math.sqrt(2))


def at_most(values: Any, limit: float) -> dict[str, Any]:
    """Returns the statistic and the p-value of the claim that a mean is at most ``limit``."""
    error = max(float(values.std()) / values.size**0.5, 1e-9)
    return {"statistic": f"{values.mean():.4f}", "p_value": normal_p(max(0.0, float(values.mean()) - limit) / error)}


def welch(a: np.ndarray, b: np.ndarray) -> dict[str, Any]:
    """Returns the statistic and the p-value of Welch's test that two large samples have the same mean."""
    error = math.sqrt(a.var(ddof=1) / a.size + b.var(ddof=1) / b.size)
    mean_a, mean_b = float(a.mean()), float(b.mean())
    beyond = max(0.0, abs(mean_a - mean_b) - 1e-4 * max(abs(mean_a), abs(mean_b)))  # rounding of single precision
    p = normal_p(beyond / error) if error else float(beyond == 0)
    return {"statistic": f"{mean_a:.4g} and {mean_b:.4g}", "p_value": p}


def add_welch(report: Any, test: str, a: np.ndarray, b: np.ndarray, where: str) -> None:
    """Adds the result of Welch's test to ``report``."""
    report.add(test, where=where, **welch(a, b))


def chi_squared(
    report: Any, test: str, where: str, sample: Callable, pdf: Callable, domain: Any = None, dimensions: int = 3
) -> None:
    """Adds the result of a chi-squared test to ``report``.

    ``sample`` maps uniform numbers to directions, or to directions and weights 0 or 1; ``pdf`` is the density of a
    direction. If the integral of the density over the cells changes with finer steps, the lobe is too narrow for the
    cells, and is not tested.
    """
    from mitsuba.chi2 import ChiSquareTest, SphericalDomain

    domain = domain or SphericalDomain()
    chi2 = ChiSquareTest(domain, sample, pdf, dimensions, SAMPLES, CELLS, POINTS[0], seed=1)
    p = _p_value(chi2)
    if not p >= 1e-3:
        coarse, chi2.ires, chi2.pdf, chi2.fail = chi2.pdf, POINTS[1], None, False
        p = _p_value(chi2)
        change = float(dr.sum(dr.abs(chi2.pdf - coarse))[0] / SAMPLES)
        error = float(dr.sum(dr.abs(chi2.pdf - chi2.histogram))[0] / SAMPLES)
        if not p >= 1e-3 and change > 0.3 * error and change > 2e-3:
            report.add(test, "not tested", "the lobe is narrower than the cells", where)
            return
    effect = deviation(chi2)
    if chi2.pdf_sum[0] == 0 and chi2.histogram_sum[0] == 0:
        return
    if not p >= 1e-3 and effect < RELATIVE:
        report.add(
            test, "note" if effect > RELATIVE / 3 else "ok", f"density and samples differ by {effect:.1%}", where
        )
        return
    shape = (int(chi2.res[1]), int(chi2.res[0]))
    picture = tuple(np.array(one).reshape(shape) for one in (chi2.pdf, chi2.histogram)) if p < 1e-3 else None
    masses = f"density {chi2.pdf_sum[0]:.4f}, samples {chi2.histogram_sum[0]:.4f}"
    report.add(test, "ok", masses, where, p_value=p, picture=picture)


def deviation(chi2: Any) -> float:
    """Returns the RMS relative difference of density and samples over the cells, without the noise of the samples."""
    expected, found = np.array(chi2.pdf, dtype=float), np.array(chi2.histogram, dtype=float)
    full = expected > 5
    excess = (np.square(found - expected) / np.maximum(expected, 1e-9))[full].sum() - full.sum()
    lost = found[~full].sum() - expected[~full].sum()
    return float(np.sqrt(max(0.0, excess) / SAMPLES) + abs(lost) / SAMPLES)


def _p_value(chi2: Any) -> float:
    """Runs the test; returns its p-value, 0 for samples where the density is 0 and the like."""
    chi2.messages = ""
    chi2.run(0.01, quiet=True)
    few = "degrees of freedom is too low" in chi2.messages
    if few:  # all samples lie in one cell: only the masses can be compared
        same = abs(float(chi2.pdf_sum[0] - chi2.histogram_sum[0])) < 0.02
        return float(same)
    return 0.0 if chi2.fail or not np.isfinite(chi2.p_value) else float(max(chi2.p_value, 0.0))


def uniform_inputs(n: int, dimensions: int, seed: int = 1) -> np.ndarray:
    """Returns uniform numbers in [0, 1), shape (dimensions, n), in single precision."""
    numbers = np.random.default_rng(seed).random((dimensions, n), dtype=np.float32)
    return np.minimum(numbers, np.float32(1 - 2**-24))


def directions(n: int, seed: int) -> np.ndarray:
    """Returns unit vectors, shape (3, n): uniform on the sphere, and one of eight near the horizon."""
    u, v = uniform_inputs(n, 2, seed + 1000)
    z = 2 * u - 1
    z[::8] *= 0.02
    r, phi = np.sqrt(1 - z * z), 2 * np.pi * v
    return np.stack([r * np.cos(phi), r * np.sin(phi), z]).astype(np.float32)


def rows(value: Any, n: int) -> np.ndarray:
    """Returns a number, a vector or a spectrum as an array of shape (components, n); a polarised one unpolarised."""
    if dr.is_matrix_v(value):
        value = mi.unpolarized_spectrum(value)
    array = np.array(value, dtype=float)
    array = array.reshape(-1, 1) if not dr.is_jit_v(value) and array.ndim == 1 else np.atleast_2d(array)
    return np.broadcast_to(array, (array.shape[0], n))
