"""Tests of a texture or a spectrum."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..report import NOTE, OK, Report
from ..statistics import chi_squared, rows, uniform_inputs
from ..subject import Subject

#: Number of places.
INPUTS = 2**14

#: Either light or reflectances, see :func:`.reloading.compare`; values whose derivatives are tested.
EMITS, SMOOTH = None, ("eval()",)


def at(uv: Any) -> Any:
    """Points of a surface at ``uv``."""
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(uv)) if dr.is_jit_v(mi.Float) else dr.zeros(mi.SurfaceInteraction3f)
    si.uv, si.p, si.t = mi.Point2f(uv), mi.Point3f(uv.x, uv.y, 0), mi.Float(1)
    if mi.is_spectral:
        si.wavelengths = mi.UnpolarizedSpectrum(450, 520, 590, 650)
    return si


def places(seed: int = 1, n: int = INPUTS) -> np.ndarray:
    """Coordinates in [0, 1), shape (2, n)."""
    return uniform_inputs(n, 2, seed)


def colours(texture: Any, uv: np.ndarray) -> np.ndarray:
    """eval() at places, shape (channels, n)."""
    return rows(texture.eval(at(mi.Point2f(uv))), uv.shape[1])


def where(uv: np.ndarray) -> Callable[[int], str]:
    """The place of input i."""
    return lambda i: f"uv ({uv[0, i]:.3f}, {uv[1, i]:.3f})"


def test_methods(subject: Subject, report: Report) -> None:
    """eval_3() is eval(); eval_1() is eval() where it is grey, and its luminance elsewhere."""
    texture, uv = subject.load(), places()
    value = colours(texture, uv)
    report.require("eval() is finite", np.isfinite(value).all(axis=0), where=where(uv))
    if "rgb" in (mi.variant() or ""):
        try:
            report.equal("eval_3() = eval()", np.array(texture.eval_3(at(mi.Point2f(uv)))), value, where(uv))
        except RuntimeError as error:
            report.add("eval_3() = eval()", "not tested", str(error).splitlines()[-1])
    luminance = np.array([[0.212671, 0.715160, 0.072169]]) @ value if len(value) == 3 else value[:1]
    one = np.array(texture.eval_1(at(mi.Point2f(uv))))
    mean = value.mean(axis=0)
    close = np.abs(one - mean) < np.abs(one - luminance[0])  # a plugin may mean either
    report.equal("eval_1() = eval()", one, np.where(close, mean, luminance[0]), where(uv))


def test_gradient(subject: Subject, report: Report) -> None:
    """eval_1_grad() is the difference of eval_1() between near places."""
    texture, uv, h = subject.load(), places(2), 3e-4
    shifts = [mi.Point2f(uv + np.array(d, dtype=np.float32)[:, None] * h) for d in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    right, left, up, down = (np.array(texture.eval_1(at(shift)), dtype=float) for shift in shifts)
    difference = np.broadcast_to(np.stack([right - left, up - down]) / (2 * h), uv.shape)
    gradient = np.broadcast_to(np.array(texture.eval_1_grad(at(mi.Point2f(uv)))), uv.shape)
    report.equal("eval_1_grad() = differences", gradient, difference, where(uv), tolerance=0.05, share=0.25, floor=0.05)


def test_mean_and_max(subject: Subject, report: Report) -> None:
    """mean() is the mean of eval(), and max() is not below it."""
    texture, side = subject.load(), 512
    grid = (np.indices((side, side)).reshape(2, -1) + places(3, side * side)).astype(np.float32) / side
    value = colours(texture, grid)
    if "rgb" in (mi.variant() or "") and "to_uv" not in subject.props:
        means = [value.mean(), float((np.array([0.212671, 0.715160, 0.072169]) @ value).mean())]
        found = float(np.array(texture.mean()).ravel()[0])
        nearest = min(means, key=lambda mean: abs(mean - found))
        report.equal("mean() = the mean of eval()", [found], [nearest], tolerance=0.02, floor=0.01)
    try:
        largest = float(np.array(texture.max()).ravel()[0])
    except RuntimeError:
        return
    report.require(
        "max() is not below eval()", [value.max() <= largest * 1.001 + 1e-6], f"{value.max():.4g} > {largest:.4g}"
    )


def test_variation(subject: Subject, report: Report) -> None:
    """A texture that depends on uv says so."""
    texture, uv = subject.load(), places(4)
    varies = bool(np.ptp(colours(texture, uv), axis=1).max() > 1e-4)
    stated = texture.is_spatially_varying()
    report.require("is_spatially_varying() is true where uv matters", [stated or not varies], "it is not")
    report.add("is_spatially_varying() is false where uv does not matter", OK if varies or not stated else NOTE)


def test_positions(subject: Subject, report: Report) -> None:
    """Places of sample_position() have the density of pdf_position()."""
    from mitsuba.chi2 import PlanarDomain

    texture = subject.load()
    uv, pdf = texture.sample_position(mi.Point2f(places(5)))
    stated = np.broadcast_to(np.array(texture.pdf_position(uv)), INPUTS)
    report.equal("pdf of a place = pdf_position()", np.array(pdf), stated)
    domain = PlanarDomain(mi.ScalarBoundingBox2f([0, 0], [1, 1]))

    def sample(u: Any) -> Any:
        return texture.sample_position(u)[0]

    def density(p: Any) -> Any:
        return texture.pdf_position(mi.Point2f(p)) + dr.zeros(mi.Float, dr.width(p))

    chi_squared(report, "samples follow pdf_position()", "", sample, density, domain=domain, dimensions=2)


def test_transform(subject: Subject, report: Report) -> None:
    """to_uv transforms uv."""
    texture, uv = subject.load(), places(6)
    if "to_uv" in subject.props:
        return
    try:
        moved = subject.load(to_uv=mi.ScalarTransform4f(np.diag([0.5, 0.3, 1.0, 1.0])))
    except (RuntimeError, TypeError):
        return
    inside = (uv * [[0.5], [0.3]]).astype(np.float32)
    report.equal("to_uv scales uv", colours(moved, uv), colours(texture, inside), where(uv), share=0.03)


def test_wavelengths(subject: Subject, report: Report) -> None:
    """Sampled wavelengths have the density of pdf_spectrum(), and the weight eval() / pdf."""
    from mitsuba.chi2 import LineDomain

    before = mi.variant() or ""
    variant = before.partition("_")[0] + "_ad_spectral"
    if "_ad_" not in before or variant not in mi.variants():
        return
    try:
        subject.set_variant(variant)
        try:
            texture = subject.load()
        except RuntimeError:
            return  # for example, data of another variant
        si = at(mi.Point2f(places(7)))
        wavelengths, weight = texture.sample_spectrum(si, mi.sample_shifted(mi.Float(places(8)[0])))
        si.wavelengths = wavelengths
        pdf, value = rows(texture.pdf_spectrum(si), INPUTS), rows(texture.eval(si), INPUTS)
        report.equal("weight of a wavelength = eval() / pdf_spectrum()", rows(weight, INPUTS) * pdf, value)

        def sample(u: Any) -> Any:
            points = dr.zeros(mi.SurfaceInteraction3f, dr.width(u))
            return mi.Vector1f(texture.sample_spectrum(points, mi.sample_shifted(u[0]))[0][0])

        def density(w: Any) -> Any:
            points = dr.zeros(mi.SurfaceInteraction3f, dr.width(w))
            points.wavelengths = w
            return texture.pdf_spectrum(points)[0]

        domain = LineDomain([float(mi.MI_CIE_MIN), float(mi.MI_CIE_MAX)])
        chi_squared(report, "samples follow pdf_spectrum()", "", sample, density, domain=domain, dimensions=1)
    finally:
        subject.set_variant(before)


def prepare(texture: Any) -> Any:
    """A texture needs no scene."""
    return texture


def inputs(n: int) -> list[np.ndarray]:
    """Places, some beyond [0, 1)."""
    return [(3 * uniform_inputs(n, 2, 81) - 1).astype(np.float32)]


def values(texture: Any, uv: Any, wavelengths: Any) -> dict[str, Any]:
    """The texture at given places."""
    si = at(uv)
    if mi.is_spectral:
        si.wavelengths = wavelengths
    return {"eval()": texture.eval(si)}


TESTS: tuple[Callable[[Subject, Report], None], ...] = (
    test_methods,
    test_gradient,
    test_mean_and_max,
    test_variation,
    test_positions,
    test_transform,
    test_wavelengths,
)
