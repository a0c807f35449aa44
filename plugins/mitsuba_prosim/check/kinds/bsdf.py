"""Tests of a BSDF."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..inputs import contexts, directions, interaction, lit, rows, uniform
from ..report import FAILS, NOTE, OK, Report
from ..statistics import chi_squared, mean_is
from ..subject import Subject

#: Number of random inputs of a test without statistics, and of samples of a mean.
INPUTS, SAMPLES = 2**14, 2**15

#: Values are reflectances, not light; values whose derivatives are tested.
LIGHT, SMOOTH = (False,), ("eval()",)

#: Angles of incidence of statistical tests, in degrees; the last is below the surface.
ANGLES = (12.0, 48.0, 77.0, 145.0)


def surface(wi: Any, uv: Any, n: int | None = None, wavelengths: Any = None) -> Any:
    """Returns points of a surface that are seen from the local directions ``wi``."""
    wi, u, v = mi.Vector3f(wi), mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
    frame, uv = mi.Frame3f(u, v, mi.Vector3f(0, 0, 1)), mi.Point2f(uv)
    fields = {"uv": uv, "t": mi.Float(1), "n": frame.n, "dp_du": u, "dp_dv": v, "p": mi.Point3f(uv.x, uv.y, 0)}
    n = n or dr.width(wi)
    return interaction(
        mi.SurfaceInteraction3f, n, wavelengths, wi=wi + dr.zeros(mi.Vector3f, n), sh_frame=frame, **fields
    )


class Queries:
    """Random inputs of a BSDF, its samples there, and directions ``out``, half of which are samples."""

    def __init__(self, bsdf: Any, ctx: Any = None, n: int = INPUTS) -> None:
        u = uniform(n, 6, 11)
        self.ctx = ctx or mi.BSDFContext()
        self.wi, self.uv = directions(n, 1), u[:2]
        self.si, self.u1, self.u2 = surface(self.wi, self.uv), mi.Float(u[2]), mi.Point2f(u[3:5])
        bs, weight = bsdf.sample(self.ctx, self.si, self.u1, self.u2)
        self.weight, self.pdf, self.wo, self.eta = (rows(v, n) for v in (weight, bs.pdf, bs.wo, bs.eta))
        self.type = rows(bs.sampled_type, n)[0].astype(int)
        self.valid = (self.pdf[0] > 0) & (self.weight > 0).any(axis=0)
        self.smooth = self.valid & ~self.has(mi.BSDFFlags.Delta)
        self.out = np.where(self.smooth & (u[5] < 0.5), self.wo, directions(n, 2)).astype(np.float32)
        self.value, self.density = (rows(v, n) for v in bsdf.eval_pdf(self.ctx, self.si, mi.Vector3f(self.out)))

    def has(self, flag: Any) -> np.ndarray:
        """Whether each sample has one of the types in ``flag``."""
        return self.type & int(flag) != 0

    def where(self, i: int) -> str:
        """The angles of input i."""
        return angles(self.wi[:, i], self.out[:, i])

    def sampled(self, i: int) -> str:
        """The angles of input i and its sample."""
        return angles(self.wi[:, i], self.wo[:, i])


def angles(wi: np.ndarray, wo: np.ndarray) -> str:
    """Describes two directions by their angles to the normal, and the difference of their azimuths."""
    theta = [np.degrees(np.arccos(np.clip(v[2], -1, 1))) for v in (wi, wo)]
    phi = np.degrees(np.arctan2(wo[1], wo[0]) - np.arctan2(wi[1], wi[0])) % 360
    return f"wi {theta[0]:.1f}°, wo {theta[1]:.1f}°, azimuth {phi:.0f}°"


def incidences(bsdf: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yields the name, the direction wi and uv of each incidence of a statistical test."""
    two_sided = bsdf.flags() & int(mi.BSDFFlags.BackSide | mi.BSDFFlags.Transmission)
    for i, angle in enumerate(ANGLES if two_sided else ANGLES[:-1]):
        sin, cos = float(np.sin(np.radians(angle))), float(np.cos(np.radians(angle)))
        wi, uv = mi.Vector3f(0.8 * sin, 0.6 * sin, cos), mi.Point2f(0.3 + 0.17 * i, 0.61 - 0.2 * i)
        dr.make_opaque(wi, uv)
        yield f"wi {angle:.0f}°", wi, uv


def test_finite(subject: Subject, report: Report) -> None:
    """Values, densities and weights are finite and not negative, also at grazing angles and extreme numbers."""
    bsdf, flag = subject.load(), mi.BSDFFlags
    z = np.array([1e-7, 1e-4, 1e-3, 0.03, 0.7, 1, -1e-7, -1e-3, -0.7, -1], dtype=np.float32)
    extremes = np.array([0, 2**-24, 0.5, 1 - 2**-24], dtype=np.float32)
    cos_i, cos_o, *u = (one.ravel() for one in np.meshgrid(z, z, extremes, extremes, extremes))
    wi = np.stack([np.sqrt(1 - cos_i**2), 0 * cos_i, cos_i])
    wo = np.stack([-0.8 * np.sqrt(1 - cos_o**2), 0.6 * np.sqrt(1 - cos_o**2), cos_o])
    si = surface(wi, (0.3, 0.6))
    bs, weight = bsdf.sample(mi.BSDFContext(), si, mi.Float(u[0]), mi.Point2f(u[1:]))
    value, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, mi.Vector3f(wo))
    front, back = (bsdf.flags() & int(side) != 0 for side in (flag.FrontSide, flag.BackSide))
    inside, drawn = np.where(cos_i > 0, front, back), rows((bs.pdf > 0) & lit(weight))[0].astype(bool)
    where = lambda i: f"{angles(wi[:, i], wo[:, i])}, sample {[float(v[i]) for v in u]}"  # noqa: E731
    report.finite("eval()", value, where, on=inside)
    report.finite("weight", weight, where, on=inside)
    report.require("pdf() is finite", np.isfinite(rows(pdf, cos_i.size)), where, on=inside)
    report.unit("sampled directions", bs.wo, where, on=drawn)


def test_weights(subject: Subject, report: Report) -> None:
    """weight = eval() / pdf(), and eval_pdf() and eval_pdf_sample() agree with the others, in each context."""
    bsdf = subject.load()
    importance = "importance, ", mi.BSDFContext(mi.TransportMode.Importance), 0
    for name, ctx, _ in [*contexts(bsdf, mi.BSDFContext), importance]:
        q = Queries(bsdf, ctx)
        drawn, wo = mi.Vector3f(q.wo), mi.Vector3f(q.out)
        where, sampled = (lambda i, f=f, name=name: name + f(i) for f in (q.where, q.sampled))
        report.samples(q.weight, q.pdf, bsdf.eval(ctx, q.si, drawn), bsdf.pdf(ctx, q.si, drawn), sampled, on=q.smooth)
        report.equal("eval_pdf() = eval(), pdf()", q.value, bsdf.eval(ctx, q.si, wo), where)
        report.equal("eval_pdf() = eval(), pdf()", q.density, bsdf.pdf(ctx, q.si, wo), where)
        value, pdf, bs, weight = bsdf.eval_pdf_sample(ctx, q.si, wo, q.u1, q.u2)
        for a, b in ((value, q.value), (pdf, q.density), (weight, q.weight), (bs.pdf, q.pdf)):
            report.equal("eval_pdf_sample() = eval(), pdf(), sample()", a, b, where)
        report.equal("eval() is 0 in inactive lanes", bsdf.eval(ctx, q.si, wo, mi.Bool(False)), 0, where)


def test_density(subject: Subject, report: Report) -> None:
    """Directions of sample() have the density of pdf(), where the BSDF is not black."""
    bsdf, delta = subject.load(), int(mi.BSDFFlags.Delta)
    for name, ctx, flags in contexts(bsdf, mi.BSDFContext):
        for angle, wi, uv in incidences(bsdf) if flags & int(mi.BSDFFlags.Smooth) else ():

            def sample(u: Any, ctx: Any = ctx, wi: Any = wi, uv: Any = uv) -> tuple[Any, Any]:
                bs, weight = bsdf.sample(ctx, surface(wi, uv, dr.width(u)), u[0], mi.Point2f(u[1], u[2]))
                return bs.wo, ((bs.sampled_type & delta) == 0) & (bs.pdf > 0) & lit(weight)

            def pdf(wo: Any, ctx: Any = ctx, wi: Any = wi, uv: Any = uv) -> Any:
                value, density = bsdf.eval_pdf(ctx, surface(wi, uv, dr.width(wo)), wo)
                return dr.select(lit(value), density, 0)

            chi_squared(report, "samples follow pdf()", name + angle, sample, pdf)


def is_fibre(bsdf: Any) -> bool:
    """Whether a lobe both reflects and transmits, as in hair, whose directions have no sides."""
    both = int(mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.GlossyTransmission)
    return any(bsdf.flags(i) & both == both for i in range(bsdf.component_count()))


def turned(bsdf: Any, q: Queries) -> np.ndarray:
    """The values after a turn of all directions about the normal."""
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]], dtype=np.float32)
    return rows(bsdf.eval(q.ctx, surface(turn @ q.wi, q.uv), mi.Vector3f(turn @ q.out)))


def is_tilted(bsdf: Any) -> bool:
    """Whether a map tilts the normal: the azimuth matters, and differently at different places."""
    q = Queries(bsdf, n=2**10)
    moved = rows(bsdf.eval(q.ctx, surface(q.wi, q.uv[::-1]), mi.Vector3f(q.out)))
    atol = 1e-4 * float(np.nan_to_num(q.value).mean())
    return not any(np.allclose(v, q.value, rtol=0.05, atol=atol) for v in (turned(bsdf, q), moved))


def test_symmetry(subject: Subject, report: Report) -> None:
    """f(wi, wo) = f(wo, wi), where radiance one way is importance the other way; without a flag, a turn is nothing."""
    bsdf = subject.load()
    q, tilted = Queries(bsdf), is_tilted(bsdf)
    back = bsdf.eval(mi.BSDFContext(mi.TransportMode.Importance), surface(q.out, q.uv), mi.Vector3f(q.wi))
    cosines = np.abs(q.wi[2]), np.abs(q.out[2])
    steep, worst = np.minimum(*cosines) > 0.02, NOTE if tilted or is_fibre(bsdf) else FAILS
    limits = {"tolerance": 0.05, "share": 0.01, "floor": 0.02}
    report.equal("reciprocity", q.value / cosines[1], rows(back) / cosines[0], q.where, on=steep, worst=worst, **limits)
    if not tilted and not bsdf.flags() & int(mi.BSDFFlags.Anisotropic):
        test = "without the flag Anisotropic, a turn changes nothing"
        report.equal(test, turned(bsdf, q), q.value, q.where, tolerance=0.03)


def test_albedo(subject: Subject, report: Report) -> None:
    """No direction reflects and transmits more than arrives."""
    bsdf, u = subject.load(), uniform(SAMPLES, 3, 3)
    ctx = mi.BSDFContext(mi.TransportMode.Importance)
    for angle, wi, uv in incidences(bsdf):
        weight = rows(bsdf.sample(ctx, surface(wi, uv, SAMPLES), mi.Float(u[0]), mi.Point2f(u[1:]))[1], SAMPLES)
        brightest = weight[np.argmax(weight.mean(axis=1))]
        report.add("albedo at most 1", where=angle, **mean_is(brightest, 0, 1.002))


def test_flags(subject: Subject, report: Report) -> None:
    """The flags tell what is sampled, and where the BSDF is not 0."""
    bsdf, flag = subject.load(), mi.BSDFFlags
    lobes = np.array([bsdf.flags(i) for i in range(bsdf.component_count())] or [0])
    union, kinds, q = int(np.bitwise_or.reduce(lobes)), int(flag.All), Queries(bsdf)
    report.require("flags() = those of all components", [bsdf.flags() == union])
    report.require("sampled_type is a lobe of flags()", q.has(kinds) & ~q.has(kinds & ~union), q.sampled, on=q.valid)
    for one in lobes:
        found = (q.has(one & kinds) & (q.pdf[0] > 0)).any()
        report.add("every lobe of the flags is sampled", OK if found else FAILS, f"type {one & kinds:#x}")
    cos, carries = q.wi[2] * q.out[2], (q.value != 0).any(axis=0)
    allowed = np.zeros(INPUTS, dtype=bool)
    for one in lobes[lobes & int(flag.Smooth) != 0]:
        side = np.where(q.wi[2] > 0, one & int(flag.FrontSide), one & int(flag.BackSide)) != 0
        allowed |= side & (np.where(cos > 0, one & int(flag.Reflection), one & int(flag.Transmission)) != 0)
    worst = NOTE if is_fibre(bsdf) else FAILS
    report.require("eval() is 0 where the flags have no lobe", ~carries | allowed, q.where, worst=worst)


def test_sampled_types(subject: Subject, report: Report) -> None:
    """A sample goes where its type says."""
    q, flag = Queries(subject.load()), mi.BSDFFlags
    cos, reflects, passes = q.wi[2] * q.wo[2], q.has(flag.Reflection), q.has(flag.Transmission) | q.has(flag.Null)
    opposite = np.abs(q.wo - q.wi * [[-1], [-1], [1]]).max(axis=0) < 1e-3
    sines = [np.linalg.norm(v[:2], axis=0) for v in (q.wi, q.wo)]
    obeys = np.abs(sines[0] - q.eta * sines[1]) < 2e-3
    for test, on, right in (
        ("reflection stays on its side", reflects & ~passes, cos > -1e-4),
        ("transmission leaves its side", passes & ~reflects, cos < 1e-4),
        ("a null lobe goes straight on", q.has(flag.Null), np.abs(q.wo + q.wi) < 1e-3),
        ("eta of reflection is 1", reflects, np.abs(q.eta - 1) < 1e-5),
        ("ideal reflection mirrors wi", q.has(flag.DeltaReflection), opposite),
        ("ideal refraction obeys Snell's law", q.has(flag.DeltaTransmission), obeys),
    ):
        report.require(test, right, q.sampled, on=on & q.valid)


def test_components(subject: Subject, report: Report) -> None:
    """The values of the components add up to the whole."""
    bsdf = subject.load()
    q, ctxs = Queries(bsdf), [ctx for name, ctx, _ in contexts(bsdf, mi.BSDFContext) if name]
    parts = [rows(bsdf.eval(ctx, q.si, mi.Vector3f(q.out)), INPUTS) for ctx in ctxs]
    if not all(np.allclose(part, q.value) for part in parts):  # a BSDF may ignore the context's component
        report.equal("components add up to the whole", sum(parts), q.value, q.where)


def test_ideal_lobes(subject: Subject, report: Report) -> None:
    """Ideal lobes have their probability."""
    bsdf, delta = subject.load(), int(mi.BSDFFlags.Delta)
    u = uniform(SAMPLES, 3, 5)
    for angle, wi, uv in incidences(bsdf) if bsdf.flags() & delta else ():
        bs, _ = bsdf.sample(mi.BSDFContext(), surface(wi, uv, SAMPLES), mi.Float(u[0]), mi.Point2f(u[1:]))
        pdf, ideal = rows(bs.pdf, SAMPLES)[0], rows(bs.sampled_type, SAMPLES)[0].astype(int) & delta != 0
        for stated in np.unique(pdf[ideal & (pdf > 0)].round(4)):
            share = mean_is(ideal & (np.abs(pdf - stated) < 1e-4), stated - 1e-3, stated + 1e-3)
            report.add("ideal lobes have their probability", where=f"{angle}, pdf {stated:.4f}", **share)


def test_refraction(subject: Subject, report: Report) -> None:
    """The weights of radiance and importance differ by eta squared, and a facet refracts wi to wo."""
    bsdf = subject.load()
    if not bsdf.flags() & int(mi.BSDFFlags.Transmission):
        return
    q, other = Queries(bsdf), Queries(bsdf, mi.BSDFContext(mi.TransportMode.Importance))
    same = q.valid & other.valid & (np.abs(q.wo - other.wo).max(axis=0) < 1e-3)
    report.equal("radiance = importance / eta²", q.weight, other.weight / q.eta**2, q.sampled, on=same)
    half = q.wi + q.eta * q.wo
    cosines = [(half * v).sum(axis=0) * v[2] * half[2] for v in (q.wi, q.wo)]
    refracts = q.valid & (np.abs(q.eta[0] - 1) > 1e-3) & (np.abs(q.wi[2]) > 0.05) & (np.abs(q.wo[2]) > 0.05)
    report.require("a facet refracts wi to wo", np.array(cosines) > -1e-4, q.sampled, on=refracts, share=0.02)


def test_indices(subject: Subject, report: Report) -> None:
    """Light that enters from the front meets the index int_ior / ext_ior, where these are parameters."""
    try:
        q = Queries(subject.load(int_ior=1.9, ext_ior=1.2))
    except RuntimeError:
        return
    enters = q.valid & (q.wi[2] > 0) & (q.wo[2] < 0) & (q.eta[0] != 1)
    report.equal("eta from the front = int_ior / ext_ior", q.eta, 1.9 / 1.2, q.sampled, on=enters)


def inputs(n: int) -> list[np.ndarray]:
    """Two directions, uv and uniform numbers; two of three pairs of directions are on one side."""
    u = 0.02 + 0.96 * uniform(n, 5, 71)
    wi, wo = directions(n, 72), directions(n, 73)
    wo[2] *= np.sign(wo[2] * wi[2]) * np.where(np.arange(n) % 3 == 0, -1, 1)
    return [wi, wo, u[:2], u[2:3], u[3:]]


def values(bsdf: Any, wi: Any, wo: Any, uv: Any, u1: Any, u2: Any, wavelengths: Any) -> dict[str, Any]:
    """Values, densities and weights at given inputs."""
    si, ctx = surface(wi, uv, None, wavelengths), mi.BSDFContext()
    value, pdf = bsdf.eval_pdf(ctx, si, wo)
    bs, weight = bsdf.sample(ctx, si, u1, u2)
    return {"eval()": value, "pdf()": pdf, "weight times pdf of sample()": dr.select(bs.pdf > 0, weight * bs.pdf, 0)}


TESTS = (
    test_finite, test_weights, test_flags, test_sampled_types, test_density, test_ideal_lobes, test_refraction,
    test_components, test_symmetry, test_albedo, test_indices,
)  # fmt: skip
