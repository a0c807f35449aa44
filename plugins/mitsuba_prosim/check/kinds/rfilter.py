"""Tests of a reconstruction filter."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from ..inputs import rows, uniform
from ..report import Report
from ..subject import Subject


def test_values(subject: Subject, report: Report) -> None:
    """eval() is symmetric, 0 beyond the radius, and positive on the whole."""
    rfilter, n = subject.load(), 2**12
    x = uniform(n, 1)[0] * rfilter.radius()
    value, mirrored, beyond = (rows(rfilter.eval(mi.Float(v)), n) for v in (x, -x, x + 1.001 * rfilter.radius()))
    where = lambda i: f"x = {x[i]:.3f}"  # noqa: E731
    report.require("eval() is finite", np.isfinite(value), where)
    report.equal("eval() is symmetric", mirrored, value, where)
    report.require("eval() is 0 beyond radius()", np.abs(beyond) < 1e-5, where)
    report.require("the integral is positive", [value.mean() > 0])
    report.require("border_size() holds the radius", [rfilter.border_size() >= rfilter.radius() - 0.5 - 1e-3])


TESTS = (test_values,)
