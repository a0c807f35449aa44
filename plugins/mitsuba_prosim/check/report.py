"""What a check found: results, their table, their JSON and their pictures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib.util import find_spec
from itertools import groupby
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from .inputs import rows
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
        self, test: str, values: Any, expected: Any, where: Any = None, *, on: Any = True, worst: str = FAILS,
        **limits: float,
    ) -> None:  # fmt: skip
        """Adds the result of comparing two arrays of shape (..., n), or values of Dr.Jit, in the columns ``on``.

        Values differ if their difference is above ``tolerance`` (0.02) times the larger one, and above ``floor`` (1e-4)
        times the mean of ``expected``. Not more than the ``share`` (0.005) of the columns may differ, because a few
        inputs lie where single precision is coarse. ``where`` is a text, or a function that describes column i.
        ``worst`` is the verdict if too many differ.
        """
        tolerance, floor, share = ({"tolerance": 0.02, "floor": 1e-4, "share": 0.005} | limits).values()
        values, expected, _ = np.broadcast_arrays(rows(values), rows(expected), on)
        both = ~np.isfinite(values) & ~np.isfinite(expected)  # another test reports these
        values, expected = np.where(both, 0, values), np.where(both, 0, expected)
        on = np.broadcast_to(on, values.shape[1])
        if not on.any():
            return
        larger, difference = np.maximum(np.abs(values), np.abs(expected)), np.abs(values - expected)
        scale = floor * np.nanmean(np.minimum(np.abs(expected[:, on]), 1e6)) + 1e-12
        off = on & ~(difference <= np.maximum(tolerance * larger, scale)).all(axis=0)
        if off.sum() <= share * on.sum():
            self.add(test, statistic=f"{on.sum()} values agree")
            return
        i = self._median(off, (difference / np.maximum(larger, 1e-30)).max(axis=0))
        channel = int(np.argmax(difference[:, i]))
        numbers = f"{values[channel, i]:.4g} instead of {expected[channel, i]:.4g}"
        self.add(test, worst, f"{numbers}; {off.sum() / on.sum():.1%} of {on.sum()} differ", _place(where, i))

    def require(
        self, test: str, right: Any, where: Any = None, *, on: Any = True, share: float = 0.0, worst: str = FAILS
    ) -> None:
        """Adds the result of a condition: ``right`` is an array of shape (..., n) of booleans, which is tested in the
        columns ``on``; the ``share`` of them may be false.
        """
        right, on = np.broadcast_arrays(np.atleast_2d(right).all(axis=0), on)
        wrong = on & ~right
        if wrong.sum() <= share * on.sum():
            self.add(test)
            return
        count = f" ({wrong.sum()} of {on.sum()})" if on.sum() > 1 else ""
        self.add(test, worst, f"not so{count}", _place(where, self._median(wrong, np.arange(wrong.size))))

    def finite(self, name: str, values: Any, where: Any = None, *, on: Any = True, least: float = 0.0) -> None:
        """Adds whether values are finite, and not below ``least``."""
        values = rows(values)
        self.require(f"{name} is finite, not negative", np.isfinite(values) & (values >= least), where, on=on)

    def samples(self, weight: Any, pdf: Any, value: Any, stated: Any, where: Any = None, *, on: Any = True) -> None:
        """Adds whether weights and densities of samples are those of ``value`` and the ``stated`` density."""
        self.equal("weight of a sample = eval() / pdf()", rows(weight) * rows(pdf), value, where, on=on)
        self.equal("pdf of a sample = pdf()", pdf, stated, where, on=on)

    def unit(self, name: str, vectors: Any, where: Any = None, *, on: Any = True) -> None:
        """Adds whether vectors have the length 1."""
        length = np.linalg.norm(rows(vectors), axis=0)
        self.require(f"{name} are unit vectors", np.abs(length - 1) < 1e-3, where, on=on, share=0.01)

    @staticmethod
    def _median(chosen: np.ndarray, order: np.ndarray) -> int:
        """The column in the middle of the chosen ones."""
        columns = np.flatnonzero(chosen)
        return int(columns[np.argsort(order[columns])[len(columns) // 2]])

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
        if find_spec("matplotlib") is None:
            return []
        wrong = [result for result in self.results if result.verdict == FAILS and result.picture is not None]
        return [_picture(result, folder / f"check-{self.plugin}-{i}.png") for i, result in enumerate(wrong)]


def _place(where: Any, i: int) -> str:
    return where(i) if callable(where) else where or ""


def _picture(result: Result, path: Path) -> Path:
    """Writes density, histogram and difference of a failed test side by side."""
    from matplotlib.figure import Figure

    density, histogram = result.picture
    figure = Figure(figsize=(12, 3), layout="constrained")
    figure.suptitle(f"{result.test}: {result.where}")
    limit = max(float(np.quantile(density, 0.999)), 1e-6)
    images = {"density (pdf)": density, "histogram (sample)": histogram, "histogram - density": histogram - density}
    for axes, (title, values) in zip(figure.subplots(1, 3), images.items()):
        image = axes.imshow(values, vmin=min(0, values.min()), vmax=limit, aspect="auto")
        axes.set(title=title, xlabel="first coordinate", ylabel="second coordinate")
        figure.colorbar(image, ax=axes)
    figure.savefig(path, dpi=100)
    return path
