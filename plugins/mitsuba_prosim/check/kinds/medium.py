"""Tests of a medium."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..report import Report
from ..statistics import chi_squared, rows, uniform_inputs
from ..subject import Subject

#: Number of inputs.
INPUTS = 2**13


def rays(n: int) -> Any:
    """Rays through the unit cube."""
    return mi.Ray3f(mi.Point3f(uniform_inputs(n, 3, 1) * 0.2), dr.normalize(mi.Vector3f(uniform_inputs(n, 3, 2) + 0.1)))


def test_coefficients(subject: Subject, report: Report) -> None:
    """Coefficients are not negative; scattering is a part of the extinction, and null collisions fill the majorant."""
    medium, ray = subject.load(), rays(INPUTS)
    mei = medium.sample_interaction(ray, mi.Float(uniform_inputs(INPUTS, 1, 3)[0]), mi.UInt32(0), mi.Bool(True))
    found = rows(mei.is_valid(), INPUTS)[0].astype(bool)
    scattering, null, extinction = (rows(v, INPUTS) for v in medium.get_scattering_coefficients(mei))
    majorant = rows(medium.get_majorant(mei), INPUTS)
    least = np.minimum(np.minimum(scattering, null), extinction)
    report.require("coefficients are not negative", least >= -1e-4 * majorant, "they are", on=found)
    report.require("sigma_s is at most sigma_t", scattering <= extinction * 1.001 + 1e-6, on=found)
    report.equal("majorant = sigma_t + sigma_n", extinction + null, majorant, on=found)


def test_distances(subject: Subject, report: Report) -> None:
    """Sampled distances are exponential with the majorant; transmittance_eval_pdf() is their density."""
    from mitsuba.chi2 import LineDomain

    medium = subject.load()
    if not medium.is_homogeneous():
        return

    def sample(u: Any) -> Any:
        mei = medium.sample_interaction(rays(dr.width(u)), u[0], mi.UInt32(0), mi.Bool(True))
        return mi.Vector1f(1 - dr.exp(-mei.t * mi.unpolarized_spectrum(medium.get_majorant(mei))[0]))

    chi_squared(
        report,
        "sampled distances are exponential",
        "",
        sample,
        lambda x: mi.Float(1) + 0 * x,
        domain=LineDomain([0.0, 1.0]),
        dimensions=1,
    )
    mei = medium.sample_interaction(
        rays(INPUTS), mi.Float(uniform_inputs(INPUTS, 1, 3)[0]), mi.UInt32(0), mi.Bool(True)
    )
    si = dr.zeros(mi.SurfaceInteraction3f, INPUTS)
    si.t = dr.full(mi.Float, dr.inf, INPUTS)
    through, pdf = medium.transmittance_eval_pdf(mei, si, mi.Bool(True))
    majorant = rows(medium.get_majorant(mei), INPUTS)
    expected = np.exp(-majorant * rows(mei.t, INPUTS))
    report.equal("transmittance is exponential", rows(through, INPUTS), expected)
    report.equal("pdf of a distance = majorant times transmittance", rows(pdf, INPUTS), expected * majorant)


TESTS = test_coefficients, test_distances
