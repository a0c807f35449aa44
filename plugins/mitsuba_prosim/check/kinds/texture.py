"""Tests of a texture or a spectrum."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..inputs import interaction, place, rows, uniform
from ..report import Report
from ..statistics import chi_squared
from ..subject import Subject

#: Number of places.
INPUTS = 2**14

#: A texture is either a reflectance or light; values whose derivatives are tested.
LIGHT, SMOOTH = (False, True), ("eval()",)


def at(uv: Any, wavelengths: Any = None) -> Any:
    """Points of a surface at ``uv``."""
    uv = mi.Point2f(uv)
    p = mi.Point3f(uv.x, uv.y, 0)
    return interaction(mi.SurfaceInteraction3f, dr.width(uv), wavelengths, uv=uv, p=p, t=mi.Float(1))


def colours(texture: Any, uv: np.ndarray) -> np.ndarray:
    """eval() at places, shape (channels, n)."""
    return rows(texture.eval(at(uv)), uv.shape[1])


def nearest(found: np.ndarray, value: np.ndarray) -> np.ndarray:
    """The mean or the luminance of colours, whatever is nearer; a plugin may return either."""
    means = [value.mean(axis=0), mi.luminance(mi.Color3f(value)) if len(value) == 3 else value[0]]
    return np.choose(np.argmin([np.abs(found - np.array(mean)) for mean in means], axis=0), means)


def test_methods(subject: Subject, report: Report) -> None:
    """eval_3() is eval(); eval_1() is eval() where it is grey, and its luminance elsewhere."""
    texture, uv = subject.load(), uniform(INPUTS, 2)
    value = colours(texture, uv)
    report.require("eval() is finite", np.isfinite(value), place("uv", uv))
    one = rows(texture.eval_1(at(uv)), INPUTS)[0]
    report.equal("eval_1() = eval()", one, nearest(one, value), place("uv", uv))
    if "rgb" in (mi.variant() or ""):
        report.equal("eval_3() = eval()", texture.eval_3(at(uv)), value, place("uv", uv))


def test_gradient(subject: Subject, report: Report) -> None:
    """eval_1_grad() is the difference of eval_1() between near places."""
    texture, uv, h = subject.load(), uniform(INPUTS, 2, 2), 3e-4
    shifts = (uv + np.array(d, dtype=np.float32)[:, None] * h for d in ((1, 0), (-1, 0), (0, 1), (0, -1)))
    right, left, up, down = (rows(texture.eval_1(at(shift)), INPUTS) for shift in shifts)
    difference = np.concatenate([right - left, up - down]) / (2 * h)
    gradient = texture.eval_1_grad(at(uv))
    report.equal(
        "eval_1_grad() = differences", gradient, difference, place("uv", uv), tolerance=0.05, share=0.25, floor=0.05
    )


def test_mean_and_max(subject: Subject, report: Report) -> None:
    """mean() is the mean of eval(), max() is not below it, and a texture that depends on uv says so."""
    texture, side = subject.load(), 512
    grid = (np.indices((side, side)).reshape(2, -1) + uniform(side * side, 2, 3)).astype(np.float32) / side
    value = colours(texture, grid)
    varies = np.ptp(value, axis=1).max() > 1e-4
    report.require("is_spatially_varying() is true where uv matters", [texture.is_spatially_varying() or not varies])
    if "rgb" in (mi.variant() or "") and "to_uv" not in subject.props:
        found = rows(texture.mean())[0]
        expected = nearest(found, value.mean(axis=1, keepdims=True))
        report.equal("mean() = the mean of eval()", found, expected, tolerance=0.02, floor=0.01)
    report.require("max() is not below eval()", [value.max() <= rows(texture.max()).max() * 1.001 + 1e-6])


def test_positions(subject: Subject, report: Report) -> None:
    """Places of sample_position() have the density of pdf_position()."""
    from mitsuba.chi2 import PlanarDomain

    texture = subject.load()
    uv, pdf = texture.sample_position(mi.Point2f(uniform(INPUTS, 2, 5)))
    report.equal("pdf of a place = pdf_position()", pdf, texture.pdf_position(uv))
    chi_squared(
        report,
        "samples follow pdf_position()",
        "",
        lambda u: (texture.sample_position(u)[0], mi.Bool(True)),
        lambda p: texture.pdf_position(mi.Point2f(p)),
        PlanarDomain(mi.ScalarBoundingBox2f([0, 0], [1, 1])),
        2,
    )


def test_transform(subject: Subject, report: Report) -> None:
    """to_uv transforms uv."""
    texture, uv = subject.load(), uniform(INPUTS, 2, 6)
    if "to_uv" in subject.props:
        return
    try:
        moved = subject.load(to_uv=mi.ScalarTransform4f(np.diag([0.5, 0.3, 1.0, 1.0])))
    except (RuntimeError, TypeError):
        return
    inside = (uv * [[0.5], [0.3]]).astype(np.float32)
    report.equal("to_uv scales uv", colours(moved, uv), colours(texture, inside), place("uv", uv), share=0.03)


def test_wavelengths(subject: Subject, report: Report) -> None:
    """Sampled wavelengths have the density of pdf_spectrum(), and the weight eval() / pdf."""
    from mitsuba.chi2 import LineDomain

    variant = (mi.variant() or "").partition("_")[0] + "_ad_spectral"
    if variant not in mi.variants():
        return
    with subject.other_variant(variant):
        try:
            texture = subject.load()
        except RuntimeError:
            return  # for example, data of another variant

        def sample(u: Any) -> tuple[Any, Any]:
            si = at(dr.zeros(mi.Point2f, dr.width(u)))
            return mi.Vector1f(texture.sample_spectrum(si, mi.sample_shifted(u[0]))[0][0]), mi.Bool(True)

        def density(w: Any) -> Any:
            return texture.pdf_spectrum(at(dr.zeros(mi.Point2f, dr.width(w)), mi.UnpolarizedSpectrum(w)))[0]

        si = at(uniform(INPUTS, 2, 7))
        si.wavelengths, weight = texture.sample_spectrum(si, mi.sample_shifted(mi.Float(uniform(INPUTS, 1, 8)[0])))
        pdf = texture.pdf_spectrum(si)
        report.equal("weight of a wavelength = eval() / pdf_spectrum()", rows(weight) * rows(pdf), texture.eval(si))
        domain = LineDomain([float(mi.MI_CIE_MIN), float(mi.MI_CIE_MAX)])
        chi_squared(report, "samples follow pdf_spectrum()", "", sample, density, domain, 1)


def inputs(n: int) -> list[np.ndarray]:
    """Places, some beyond [0, 1)."""
    return [(3 * uniform(n, 2, 81) - 1).astype(np.float32)]


def values(texture: Any, uv: Any, wavelengths: Any) -> dict[str, Any]:
    """The texture at given places."""
    return {"eval()": texture.eval(at(uv, wavelengths))}


TESTS = test_methods, test_gradient, test_mean_and_max, test_positions, test_transform, test_wavelengths
