"""What a check found: results and their table, and the comparisons that make results.

The statistical ones are the chi-squared test by Mitsuba's own class, Welch's test, and Šidák's correction.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .inputs import described, rows, rows_of

#: Samples, cells per side, and points per side of a cell, of a chi-squared test.
SAMPLES, CELLS, POINTS = 2**18, 51, (6, 24)

#: RMS relative difference of density and samples below which a significant difference does not count: Mitsuba's own
#: rational approximations reach it.
RELATIVE = 0.02

#: Probability that a right plugin fails any statistical test of its report.
SIGNIFICANCE = 1e-3

#: Verdicts, the worst last.
VERDICTS = OK, SKIPPED, NOTE, FAILS = "ok", "not tested", "note", "fails"


class WrongPluginError(AssertionError):
    """A plugin failed a test; the message is the table of the report."""


@dataclass
class Result:
    """The result of one test.

    ``statistic`` is what was measured, and ``where`` tells the angles, the component or the parameter of a typical
    deviation. A statistical test has a ``p_value``; its verdict depends on the number of statistical tests, see
    :meth:`Report.finish`.
    """

    test: str
    verdict: str = OK
    statistic: str = ""
    where: str = ""
    p_value: float | None = None
    variant: str = field(default_factory=lambda: mi.variant() or "")

    def line(self, times: int) -> str:
        """Returns the result as a row of the table, which stands for ``times`` results of the test."""
        p = "" if self.p_value is None else f"p = {self.p_value:.2g}"
        measured = ", ".join(filter(None, [self.statistic, p]))
        where = f"; {self.where} ({self.variant})" if self.where and self.verdict != OK else ""
        count = f" ({times} times)" if times > 1 else ""
        return f"  {self.verdict:<11}{self.test}{count}: {measured}{where}".rstrip(": ")


class Report:
    """All results of one plugin; ``plugin`` is its name in the table, and ``kind`` is "bsdf", "emitter" and so on."""

    def __init__(self, plugin: str, kind: str = "plugin") -> None:
        self.plugin, self.kind = plugin, kind
        self.results: list[Result] = []

    @property
    def ok(self) -> bool:
        """Whether no test failed."""
        return not any(result.verdict == FAILS for result in self.results)

    def add(self, *values: Any, **more: Any) -> None:
        """Adds a :class:`Result` of the active variant, whose fields are the arguments."""
        self.results.append(Result(*values, **more))

    def require(
        self, test: str, right: Any, where: Any = "", *, on: Any = True, share: float = 0, worst: str = FAILS
    ) -> None:
        """Adds the result of a condition: ``right`` is an array of shape (..., n) of booleans, which is tested in the
        columns ``on``, if there are any; the ``share`` of them may be false.

        ``where`` is a text, or named arrays of shape (..., n) that describe the columns. ``worst`` is the verdict if
        too many are false.
        """
        right, on = np.broadcast_arrays(np.atleast_2d(right).all(axis=0), on)
        wrong, count = np.flatnonzero(on & ~right), on.sum()
        if len(wrong) > share * count:
            times = f"{len(wrong) / count:.1%} of {count} inputs fail" if count > 1 else "not so"
            self.add(test, worst, times, described(where, int(wrong[len(wrong) // 2])))
        elif count:
            self.add(test, OK, f"{count} inputs agree" if count > 1 else "")

    def equal(
        self, test: str, values: Any, expected: Any, where: Any = "", tolerance: Any = (0.02, 1e-4), **limits: Any
    ) -> None:
        """Adds the result of comparing two arrays of shape (..., n), or values of Dr.Jit.

        Values differ if their difference is above ``tolerance[0]`` times the larger one, and above ``tolerance[1]``
        times the mean of ``expected``. ``limits`` are ``on``, ``share`` and ``worst`` of :meth:`require`; by default
        0.5 % of the columns may differ, because a few inputs lie where single precision is coarse.
        """
        on = np.atleast_2d(limits.pop("on", True)).all(axis=0)
        values, expected, on = np.broadcast_arrays(*rows_of((values, expected)), on)
        if not (on := on[0]).any():
            return
        larger = np.maximum(np.abs(values), np.abs(expected))
        scale = tolerance[1] * np.nanmean(np.minimum(np.abs(expected[:, on]), 1e6)) + 1e-12
        right = np.abs(values - expected) <= np.maximum(tolerance[0] * larger, scale)
        right |= ~np.isfinite(values) & ~np.isfinite(expected)  # another test reports these
        channel = np.argmin(right, axis=0)[None]
        pairs = ("found", values), ("expected", expected)
        named = {name: np.take_along_axis(value, channel, axis=0) for name, value in pairs}
        where = named | ({where: ()} if isinstance(where, str) else where)
        self.require(test, right, where, on=on, **{"share": 0.005, **limits})

    def finite(self, name: str, values: Any, where: Any = "", *, on: Any = True, least: float = 0.0) -> None:
        """Tests that values are finite, and not below ``least``."""
        values = rows(values)
        self.require(f"{name} is finite, not negative", np.isfinite(values) & (values >= least), where, on=on)

    def unit(self, name: str, vectors: Any, where: Any = "", *, on: Any = True) -> None:
        """Adds whether vectors have the length 1."""
        length = np.linalg.norm(rows(vectors), axis=0)
        self.require(f"{name} are unit vectors", np.abs(length - 1) < 1e-3, where, on=on, share=0.01)

    def mean(self, test: str, values: np.ndarray, low: float, high: float, where: str = "") -> None:
        """Tests the claim that a mean is between ``low`` and ``high``."""
        mean, error = float(values.mean()), max(float(values.std()) / values.size**0.5, 1e-6)
        p = normal_p(max(0.0, low - mean, mean - high) / error)
        self.add(test, statistic=f"{mean:.4f}", where=where, p_value=p)

    def same_mean(self, test: str, a: np.ndarray, b: np.ndarray, where: str = "", tolerance: float = 1e-4) -> None:
        """Tests the claim that two large samples have the same mean (Welch's test), but for a relative ``tolerance``
        (for rounding).
        """
        error = math.sqrt(a.var(ddof=1) / a.size + b.var(ddof=1) / b.size)
        mean_a, mean_b = float(a.mean()), float(b.mean())
        beyond = max(0.0, abs(mean_a - mean_b) - tolerance * max(abs(mean_a), abs(mean_b)))
        p = normal_p(beyond / error) if error else float(beyond == 0)
        self.add(test, statistic=f"{mean_a:.4g} and {mean_b:.4g}", where=where, p_value=p)

    def density(
        self, test: str, sample: Callable, pdf: Callable, where: str = "", dimensions: int = 3, ends: Any = (0.0, 1.0)
    ) -> None:
        """Tests the claim that samples have a density (chi-squared test).

        ``sample`` maps ``dimensions`` uniform numbers to a result: three to a direction, two to a point of the unit
        square, one to a number between the ``ends``. It may also return a mask of valid results. ``pdf`` is the
        density. If the integral of ``pdf`` over the cells changes with finer steps, the lobe is too narrow for the
        cells.
        """
        from mitsuba.chi2 import ChiSquareTest, LineDomain, PlanarDomain, SphericalDomain

        square = mi.ScalarBoundingBox2f([0, 0], [1, 1])
        domain = (LineDomain(list(ends)), PlanarDomain(square), SphericalDomain())[dimensions - 1]

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
                self.add(test, SKIPPED, "the lobe is narrower than the cells", where)
                return
        cells = [np.array(one).reshape(int(chi2.res[1]), -1) for one in (chi2.pdf, chi2.histogram)]
        p = 1.0 if p < 1e-3 and deviation(*cells) < RELATIVE else p
        masses = f"density {chi2.pdf_sum[0]:.4f}, samples {chi2.histogram_sum[0]:.4f}"
        if p < 1e-3:
            cell = np.unravel_index(np.abs(cells[1] - cells[0]).argmax(), cells[0].shape)[::-1]
            middle = chi2.bounds.min + (mi.ScalarPoint2f(cell) + 0.5) / chi2.res * chi2.bounds.extents()
            masses += f", most different {described({'at': domain.map_forward(mi.Point2f(middle))})}"
        self.add(test, statistic=masses, where=where, p_value=p)

    def finish(self) -> Report:
        """Decides the statistical tests together (Šidák's correction); returns this report."""
        tests = [(result, result.p_value) for result in self.results if result.p_value is not None]
        limit = -math.expm1(math.log1p(-SIGNIFICANCE) / max(1, len(tests)))
        for result, p_value in tests:
            if result.verdict == OK and not p_value >= limit:
                result.verdict = FAILS
        return self

    def raise_if_wrong(self) -> None:
        """Raises :class:`WrongPluginError` if a test failed."""
        if not self.ok:
            raise WrongPluginError(self.table())

    def table(self) -> str:
        """Returns the worst result of each test as a text of one line."""
        nothing = all(result.verdict == SKIPPED for result in self.results)
        lines = [f"{self.kind} {self.plugin}: {SKIPPED if nothing else 'right' if self.ok else 'WRONG'}"]
        for test in dict.fromkeys(result.test for result in self.results):
            results = [result for result in self.results if result.test == test]
            worst = max(results, key=lambda r: (VERDICTS.index(r.verdict), -1 if r.p_value is None else -r.p_value))
            lines.append(worst.line(len(results)))
        return "\n".join(lines)


def normal_p(z: float) -> float:
    """Returns the probability of a deviation of ``z`` standard errors or more, to either side."""
    return math.erfc(abs(z) / math.sqrt(2))


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
