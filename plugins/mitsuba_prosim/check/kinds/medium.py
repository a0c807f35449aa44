"""Tests of a medium."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..inputs import rows, uniform
from ..report import Report
from ..statistics import chi_squared
from ..subject import Subject

#: Number of inputs.
INPUTS = 2**13


def sampled(medium: Any, u: Any) -> Any:
    """Interactions at sampled distances, of rays through the unit cube."""
    n = dr.width(u)
    ray = mi.Ray3f(mi.Point3f(uniform(n, 3, 1) * 0.2), dr.normalize(mi.Vector3f(uniform(n, 3, 2) + 0.1)))
    return medium.sample_interaction(ray, u, mi.UInt32(0), mi.Bool(True))


def test_coefficients(subject: Subject, report: Report) -> None:
    """Coefficients are not negative; scattering is a part of the extinction, and null collisions fill the majorant."""
    medium = subject.load()
    mei = sampled(medium, mi.Float(uniform(INPUTS, 1, 3)[0]))
    found = rows(mei.is_valid(), INPUTS)[0].astype(bool)
    scattering, null, extinction = (rows(v, INPUTS) for v in medium.get_scattering_coefficients(mei))
    majorant = rows(medium.get_majorant(mei), INPUTS)
    least = np.minimum(np.minimum(scattering, null), extinction)
    report.require("coefficients are not negative", least >= -1e-4 * majorant, on=found)
    report.require("sigma_s is at most sigma_t", scattering <= extinction * 1.001 + 1e-6, on=found)
    report.equal("majorant = sigma_t + sigma_n", extinction + null, majorant, on=found)


def test_distances(subject: Subject, report: Report) -> None:
    """Sampled distances are exponential with the majorant; transmittance_eval_pdf() is their density."""
    from mitsuba.chi2 import LineDomain

    medium = subject.load()
    if not medium.is_homogeneous():
        return

    def sample(u: Any) -> tuple[Any, Any]:
        mei = sampled(medium, u[0])
        majorant = mi.unpolarized_spectrum(medium.get_majorant(mei))[0]
        return mi.Vector1f(1 - dr.exp(-mei.t * majorant)), mi.Bool(True)

    one = LineDomain([0.0, 1.0])
    chi_squared(report, "sampled distances are exponential", "", sample, lambda _: mi.Float(1), one, 1)
    mei = sampled(medium, mi.Float(uniform(INPUTS, 1, 3)[0]))
    si = dr.zeros(mi.SurfaceInteraction3f, INPUTS)
    si.t = dr.full(mi.Float, dr.inf, INPUTS)
    through, pdf = medium.transmittance_eval_pdf(mei, si, mi.Bool(True))
    majorant = rows(medium.get_majorant(mei), INPUTS)
    expected = np.exp(-majorant * rows(mei.t, INPUTS))
    report.equal("transmittance is exponential", through, expected)
    report.equal("pdf of a distance = majorant times transmittance", pdf, expected * majorant)


TESTS = test_coefficients, test_distances
