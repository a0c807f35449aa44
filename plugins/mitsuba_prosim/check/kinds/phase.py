"""Tests of a phase function."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..inputs import contexts, directions, interaction, rows, uniform
from ..report import Report
from ..statistics import chi_squared, mean_is
from ..subject import Subject

#: Number of inputs without statistics, and of samples with them.
INPUTS, SAMPLES = 2**14, 2**17

#: Values are not light; values whose derivatives are tested.
LIGHT, SMOOTH = (False,), ("eval_pdf()",)

#: Directions of statistical tests.
INCIDENCES = (0.0, 0.0, 1.0), (0.48, -0.8, 0.36)


def medium(wi: Any, n: int | None = None, wavelengths: Any = None) -> Any:
    """Points of a medium that are seen from the directions ``wi``."""
    n = n or dr.width(wi)
    wi = mi.Vector3f(wi) + dr.zeros(mi.Vector3f, n)
    fields = {"wi": wi, "sh_frame": mi.Frame3f(wi), "p": mi.Point3f(0.3, 0.6, 0.4), "t": mi.Float(1)}
    return interaction(mi.MediumInteraction3f, n, wavelengths, **fields)


def where(wi: np.ndarray, wo: np.ndarray) -> Callable[[int], str]:
    """The angle between both directions of input i."""
    return lambda i: f"angle {np.degrees(np.arccos(np.clip(wi[:, i] @ wo[:, i], -1, 1))):.1f}°"


def test_samples(subject: Subject, report: Report) -> None:
    """Weights, densities and directions of samples fit eval_pdf()."""
    phase, u, wi = subject.load(), uniform(INPUTS, 3, 2), directions(INPUTS, 3)
    for _, ctx, _ in contexts(phase, mi.PhaseFunctionContext):
        wo, weight, pdf = phase.sample(ctx, medium(wi), mi.Float(u[0]), mi.Point2f(u[1:]))
        place = where(wi, rows(wo, INPUTS))
        report.finite("weight", weight, place)
        report.unit("sampled directions", wo, place)
        value, stated = phase.eval_pdf(ctx, medium(wi), wo)
        report.samples(weight, pdf, value, stated, place)


def test_density(subject: Subject, report: Report) -> None:
    """Directions of sample() have the density of eval_pdf()."""
    phase = subject.load()
    for name, ctx, _ in contexts(phase, mi.PhaseFunctionContext):
        for direction in INCIDENCES:
            wi = mi.Vector3f(*direction)
            dr.make_opaque(wi)

            def sample(u: Any, ctx: Any = ctx, wi: Any = wi) -> tuple[Any, Any]:
                wo, _, pdf = phase.sample(ctx, medium(wi, dr.width(u)), u[0], mi.Point2f(u[1], u[2]))
                return wo, pdf > 0

            def pdf(wo: Any, ctx: Any = ctx, wi: Any = wi) -> Any:
                return phase.eval_pdf(ctx, medium(wi, dr.width(wo)), wo)[1]

            chi_squared(report, "samples follow pdf()", f"{name}wi {direction}", sample, pdf)


def test_normalisation(subject: Subject, report: Report) -> None:
    """The phase function integrates to 1."""
    phase, u, ctx = subject.load(), uniform(SAMPLES, 3, 5), mi.PhaseFunctionContext()
    for wi in INCIDENCES:
        _, weight, _ = phase.sample(ctx, medium(wi, SAMPLES), mi.Float(u[0]), mi.Point2f(u[1:]))
        report.add("the integral is 1", where=f"wi {wi}", **mean_is(rows(weight, SAMPLES)[0], 0.997, 1.003))


def test_symmetry(subject: Subject, report: Report) -> None:
    """Light takes each path both ways; without the flag of anisotropy, only the angle matters."""
    phase, ctx, flag = subject.load(), mi.PhaseFunctionContext(), mi.PhaseFunctionFlags
    wi, wo = directions(INPUTS, 6), directions(INPUTS, 7)
    there, back = (rows(phase.eval_pdf(ctx, medium(a), mi.Vector3f(b))[0]) for a, b in ((wi, wo), (wo, wi)))
    areas = [np.ones(1), np.ones(1)]
    if phase.flags() & int(flag.Microflake):
        areas = [rows(phase.projected_area(medium(one))) for one in (wi, wo)]
        largest = rows(phase.max_projected_area()).max()
        report.require("projected_area() is at most max_projected_area()", areas[0] <= largest * 1.001)
    report.equal("reciprocity", there * areas[0], back * areas[1], where(wi, wo), tolerance=0.03)
    if not phase.flags() & int(flag.Anisotropic | flag.Microflake):
        turn = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0], [0.48, 0.64, 0.6]], dtype=np.float32)
        turned = phase.eval_pdf(ctx, medium(turn @ wi), mi.Vector3f(turn @ wo))[0]
        report.equal("without the flag Anisotropic, a turn changes nothing", turned, there, where(wi, wo))


def inputs(n: int) -> list[np.ndarray]:
    """Two directions, and uniform numbers."""
    u = 0.02 + 0.96 * uniform(n, 3, 8)
    return [directions(n, 9), directions(n, 10), u[:1], u[1:]]


def values(phase: Any, wi: Any, wo: Any, u1: Any, u2: Any, wavelengths: Any) -> dict[str, Any]:
    """Value and density at given directions, and the weight of a sample."""
    mei, ctx = medium(wi, None, wavelengths), mi.PhaseFunctionContext()
    value, pdf = phase.eval_pdf(ctx, mei, wo)
    _, weight, _ = phase.sample(ctx, mei, u1, u2)
    return {"eval_pdf()": value, "pdf of eval_pdf()": pdf, "weight of sample()": weight}


TESTS = test_samples, test_density, test_normalisation, test_symmetry
