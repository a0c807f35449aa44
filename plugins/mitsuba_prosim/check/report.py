"""What a check found: results and their table."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import mitsuba as mi
import numpy as np

from .inputs import described, rows
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
        values, expected, on = np.broadcast_arrays(rows(values), rows(expected), on)
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

    def finish(self) -> Report:
        """Decides the statistical tests together (Šidák's correction); returns this report."""
        tests = [(result, result.p_value) for result in self.results if result.p_value is not None]
        limit = sidak(SIGNIFICANCE, max(1, len(tests)))
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
        lines = [f"{self.kind} {self.plugin}: {'right' if self.ok else 'WRONG'}"]
        for test in dict.fromkeys(result.test for result in self.results):
            results = [result for result in self.results if result.test == test]
            worst = max(results, key=lambda r: (VERDICTS.index(r.verdict), -1 if r.p_value is None else -r.p_value))
            lines.append(worst.line(len(results)))
        return "\n".join(lines)
