"""What a check found: results, their table, their JSON and their pictures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from .statistics import sidak

#: Probability that a right plugin fails any statistical test of its report.
SIGNIFICANCE = 1e-3

#: Verdicts, the worst last.
VERDICTS = OK, SKIPPED, NOTE, FAILS = "ok", "not tested", "note", "fails"


class WrongPluginError(AssertionError):
    """A plugin failed a test; the message is the table of the report."""


@dataclass
class Result:
    """The result of one test.

    ``statistic`` is what was measured, and ``where`` tells the angles, the component or the parameter of the largest
    deviation. A statistical test has a ``p_value``; its verdict depends on the number of statistical tests, see
    :meth:`Report.finish`. ``picture`` is a pair of arrays (density, histogram).
    """

    test: str
    verdict: str = OK
    statistic: str = ""
    where: str = ""
    variant: str = ""
    p_value: float | None = None
    picture: Any = field(default=None, repr=False)


class Report:
    """All results of one plugin; ``plugin`` is its name in the table, and ``kind`` is "bsdf", "emitter" and so on."""

    def __init__(self, plugin: str, kind: str = "plugin") -> None:
        self.plugin, self.kind = plugin, kind
        self.results: list[Result] = []

    @property
    def ok(self) -> bool:
        """Whether no test failed."""
        return not any(result.verdict == FAILS for result in self.results)

    def add(self, test: str, verdict: str = OK, statistic: str = "", where: str = "", **more: Any) -> Result:
        """Adds a result of the active variant, and returns it."""
        self.results.append(Result(test, verdict, statistic, where, mi.variant() or "", **more))
        return self.results[-1]

    def equal(
        self,
        test: str,
        values: Any,
        expected: Any,
        where: Any = None,
        *,
        tolerance: float = 0.01,
        share: float = 0.005,
        floor: float = 1e-4,
        worst: str = FAILS,
    ) -> None:
        """Adds the result of comparing two arrays of shape (..., n).

        Values differ if their difference is above ``tolerance`` times the larger one, and above ``floor`` times the
        mean of ``expected``. Not more than the ``share`` of the n columns may differ, because a few inputs lie where
        single precision is coarse. ``where(i)`` describes column i. ``worst`` is the verdict if too many differ.
        """
        values, expected = (
            np.atleast_2d(np.asarray(one, dtype=float)) for one in np.broadcast_arrays(values, expected)
        )
        if not expected.size:
            return
        both = ~np.isfinite(values) & ~np.isfinite(expected)  # another test reports these
        values, expected = np.where(both, 0, values), np.where(both, 0, expected)
        larger = np.maximum(np.abs(values), np.abs(expected))
        scale = floor * np.nanmean(np.minimum(np.abs(expected), 1e6)) + 1e-12
        difference = np.abs(values - expected)
        off = ~(difference <= np.maximum(tolerance * larger, scale)).all(axis=0)
        if off.mean() <= share:
            self.add(test, statistic=f"{off.size} values agree")
            return
        relative = np.where(off, (difference / np.maximum(larger, 1e-30)).max(axis=0), 0)
        i = int(np.argsort(np.where(off, relative, np.inf))[off.sum() // 2])
        channel = int(np.argmax(difference[:, i]))
        numbers = f"{values[channel, i]:.4g} instead of {expected[channel, i]:.4g}"
        text = f"{numbers}; {off.mean():.1%} of {off.size} differ"
        self.add(test, worst, text, where(i) if where else "")

    def require(
        self, test: str, right: Any, statistic: str = "", where: Any = None, share: float = 0.0, worst: str = FAILS
    ) -> None:
        """Adds the result of a condition: ``right`` is an array of n booleans, of which the ``share`` may be false."""
        right = np.atleast_1d(np.asarray(right))
        wrong = np.flatnonzero(~right)
        if len(wrong) <= share * right.size:
            self.add(test)
            return
        place = where(int(wrong[len(wrong) // 2])) if where else ""
        self.add(test, worst, f"{statistic} ({len(wrong)} of {right.size})" if right.size > 1 else statistic, place)

    def finish(self) -> Report:
        """Decides the statistical tests together (Šidák's correction); returns this report."""
        tests = [(result, result.p_value) for result in self.results if result.p_value is not None]
        limit = sidak(SIGNIFICANCE, max(1, len(tests)))
        for result, p_value in tests:
            if not p_value >= limit and result.verdict == OK:
                result.verdict = FAILS
        return self

    def raise_if_wrong(self) -> None:
        """Raises :class:`WrongPluginError` if a test failed."""
        if not self.ok:
            raise WrongPluginError(self.table())

    def rows(self) -> Iterator[tuple[Result, int]]:
        """Yields the worst result of each test and variant, and the number of results there."""
        order = {name: i for i, name in enumerate(dict.fromkeys(result.test for result in self.results))}
        for _, group in groupby(sorted(self.results, key=lambda r: order[r.test]), key=lambda r: r.test):
            results = list(group)
            p_values = [1.0 if r.p_value is None else r.p_value for r in results]
            worst = max(range(len(results)), key=lambda i: (VERDICTS.index(results[i].verdict), -p_values[i]))
            yield results[worst], len(results)

    def table(self) -> str:
        """Returns the results as a text of one line for each test."""
        lines = [f"{self.kind} {self.plugin}: {'right' if self.ok else 'WRONG'}"]
        for result, count in self.rows():
            text = result.statistic + ("" if result.p_value is None else f", p = {result.p_value:.2g}")
            where = f"; {result.where} ({result.variant})" if result.where and result.verdict != OK else ""
            times = f" ({count} times)" if count > 1 else ""
            lines.append(f"  {result.verdict:<11}{result.test}{times}: {text.removeprefix(', ')}{where}".rstrip(": "))
        return "\n".join(lines)

    def json(self) -> dict[str, Any]:
        """Returns the report as dictionaries, lists, texts and numbers."""
        rows = [{k: v for k, v in vars(result).items() if k != "picture"} for result in self.results]
        return {"plugin": self.plugin, "kind": self.kind, "ok": self.ok, "results": rows}

    def write_pictures(self, folder: Path) -> list[Path]:
        """Writes a PNG image of density and histogram for each failed chi-squared test; returns their paths."""
        wrong = [result for result in self.results if result.verdict == FAILS and result.picture is not None]
        return [_picture(result, folder / f"check-{self.plugin}-{i}.png") for i, result in enumerate(wrong)]


def _picture(result: Result, path: Path) -> Path:
    """Writes density, histogram and difference of a failed test side by side."""
    from matplotlib.figure import Figure

    density, histogram = result.picture
    figure = Figure(figsize=(12, 3), layout="constrained")
    figure.suptitle(f"{result.test}: {result.where}")
    limit = max(float(np.quantile(density, 0.999)), 1e-6)
    for axes, title, values, low in zip(
        figure.subplots(1, 3),
        ("density (pdf)", "histogram (sample)", "histogram - density"),
        (density, histogram, histogram - density),
        (0, 0, -limit),
    ):
        image = axes.imshow(values, vmin=low, vmax=limit, cmap="coolwarm" if low else "viridis", aspect="auto")
        axes.set(title=title, xlabel="first coordinate", ylabel="second coordinate")
        figure.colorbar(image, ax=axes)
    figure.savefig(path, dpi=100)
    return path
