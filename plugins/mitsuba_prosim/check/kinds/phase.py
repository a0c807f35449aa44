"""Tests of a phase function."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..report import Report
from ..statistics import chi_squared, directions, normal_p, rows, uniform_inputs
from ..subject import Subject

#: Number of inputs without statistics, and of samples with them.
INPUTS, SAMPLES = 2**14, 2**17

#: Values are not light; values whose derivatives are tested.
EMITS, SMOOTH = False, ("eval_pdf()",)


def interaction(wi: Any, p: Any = None) -> Any:
    """Points of a medium that are seen from the directions ``wi``."""
    mei = dr.zeros(mi.MediumInteraction3f, dr.width(wi)) if dr.is_jit_v(mi.Float) else dr.zeros(mi.MediumInteraction3f)
    mei.wi, mei.sh_frame, mei.p, mei.t = wi, mi.Frame3f(wi), mi.Point3f(0.3, 0.6, 0.4) if p is None else p, mi.Float(1)
    if mi.is_spectral:
        mei.wavelengths = mi.UnpolarizedSpectrum(450, 520, 590, 650)
    return mei


def where(wi: np.ndarray, wo: np.ndarray) -> Callable[[int], str]:
    """The angle between both directions of input i."""
    return lambda i: f"angle {np.degrees(np.arccos(np.clip(wi[:, i] @ wo[:, i], -1, 1))):.1f}°"


def contexts(phase: Any) -> list[tuple[str, Any]]:
    """The whole phase function, and each component alone."""
    found = [("", mi.PhaseFunctionContext())]
    for i in range(phase.component_count() if phase.component_count() > 1 else 0):
        ctx = mi.PhaseFunctionContext()
        ctx.component = i
        found.append((f"component {i}, ", ctx))
    return found


def test_samples(subject: Subject, report: Report) -> None:
    """Weights, densities and directions of samples fit eval_pdf()."""
    phase, u, wi = subject.load(), uniform_inputs(INPUTS, 3, 2), directions(INPUTS, 3)
    for _, ctx in contexts(phase):
        mei = interaction(mi.Vector3f(wi))
        wo, weight, pdf = phase.sample(ctx, mei, mi.Float(u[0]), mi.Point2f(u[1:]))
        value, stated = phase.eval_pdf(ctx, mei, wo)
        weight, value, pdf, stated, wo = (rows(v, INPUTS) for v in (weight, value, pdf, stated, wo))
        place = where(wi, wo)
        found = np.isfinite(weight) & (weight >= 0) & np.isfinite(pdf) & (pdf >= 0)
        report.require("weights and densities are finite, not negative", found, where=place)
        report.require(
            "sampled directions are unit vectors", np.abs(np.linalg.norm(wo, axis=0) - 1) < 1e-3, "|wo| is not 1"
        )
        report.equal("weight of a sample = value / pdf", weight * pdf, value, place)
        report.equal("pdf of a sample = pdf of eval_pdf()", pdf, stated, place)


def test_density(subject: Subject, report: Report) -> None:
    """Directions of sample() have the density of eval_pdf()."""
    phase = subject.load()
    for name, ctx in contexts(phase):
        for wi_ in ((0.0, 0.0, 1.0), (0.48, -0.8, 0.36)):
            wi = mi.Vector3f(*wi_)
            dr.make_opaque(wi)

            def sample(u: Any, ctx: Any = ctx, wi: Any = wi) -> tuple[Any, Any]:
                mei = interaction(wi + dr.zeros(mi.Vector3f, dr.width(u)))
                wo, _, pdf = phase.sample(ctx, mei, u[0], mi.Point2f(u[1], u[2]))
                return wo, dr.select(pdf > 0, mi.Float(1), 0)

            def pdf(wo: Any, ctx: Any = ctx, wi: Any = wi) -> Any:
                return phase.eval_pdf(ctx, interaction(wi + dr.zeros(mi.Vector3f, dr.width(wo))), wo)[1] + dr.zeros(
                    mi.Float, dr.width(wo)
                )

            chi_squared(report, "samples follow the pdf", f"{name}wi {wi_}", sample, pdf)


def test_normalisation(subject: Subject, report: Report) -> None:
    """The phase function integrates to 1."""
    phase, u = subject.load(), uniform_inputs(SAMPLES, 3, 5)
    for wi in ((0.0, 0.0, 1.0), (0.48, -0.8, 0.36)):
        mei = interaction(mi.Vector3f(*wi) + dr.zeros(mi.Vector3f, SAMPLES))
        _, weight, _ = phase.sample(mi.PhaseFunctionContext(), mei, mi.Float(u[0]), mi.Point2f(u[1:]))
        weight = rows(weight, SAMPLES)[0]
        error = max(weight.std() / SAMPLES**0.5, 1e-6)
        p = normal_p(max(0.0, abs(weight.mean() - 1) - 3e-3) / error)
        report.add("the integral is 1", statistic=f"{weight.mean():.4f}", where=f"wi {wi}", p_value=p)


def test_symmetry(subject: Subject, report: Report) -> None:
    """Light takes each path both ways; without the flag of anisotropy, only the angle matters."""
    phase, ctx, flag = subject.load(), mi.PhaseFunctionContext(), mi.PhaseFunctionFlags
    wi, wo = directions(INPUTS, 6), directions(INPUTS, 7)
    there, back = interaction(mi.Vector3f(wi)), interaction(mi.Vector3f(wo))
    value = rows(phase.eval_pdf(ctx, there, mi.Vector3f(wo))[0], INPUTS)
    other = rows(phase.eval_pdf(ctx, back, mi.Vector3f(wi))[0], INPUTS)
    areas = [np.ones(INPUTS), np.ones(INPUTS)]
    if phase.flags() & int(flag.Microflake):
        areas = [np.array(phase.projected_area(one)) for one in (there, back)]
        largest = float(np.array(phase.max_projected_area()).ravel()[0])
        report.require("projected_area() is at most max_projected_area()", areas[0] <= largest * 1.001, "it is not")
    report.equal("reciprocity", value * areas[0], other * areas[1], where(wi, wo), tolerance=0.03)
    if not phase.flags() & int(flag.Anisotropic | flag.Microflake):
        turn = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0], [0.48, 0.64, 0.6]], dtype=np.float32)
        mei = interaction(mi.Vector3f(turn @ wi))
        other = rows(phase.eval_pdf(ctx, mei, mi.Vector3f(turn @ wo))[0], INPUTS)
        report.equal(
            "without the flag Anisotropic, a turn changes nothing", other, value, where(wi, wo), tolerance=0.02
        )


def prepare(phase: Any) -> Any:
    """A phase function needs no scene."""
    return phase


def inputs(n: int) -> list[np.ndarray]:
    """Two directions, and uniform numbers."""
    u = 0.02 + 0.96 * uniform_inputs(n, 3, 8)
    return [directions(n, 9), directions(n, 10), u[:1], u[1:]]


def values(phase: Any, wi: Any, wo: Any, u1: Any, u2: Any, wavelengths: Any) -> dict[str, Any]:
    """Value and density at given directions, and the weight of a sample."""
    mei, ctx = interaction(wi), mi.PhaseFunctionContext()
    if mi.is_spectral:
        mei.wavelengths = wavelengths
    value, pdf = phase.eval_pdf(ctx, mei, wo)
    _, weight, _ = phase.sample(ctx, mei, u1, u2)
    return {"eval_pdf()": value, "pdf of eval_pdf()": pdf, "weight of sample()": weight}


TESTS: tuple[Callable[[Subject, Report], None], ...] = (test_samples, test_density, test_normalisation, test_symmetry)
