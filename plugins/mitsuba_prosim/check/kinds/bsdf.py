"""Tests of a BSDF."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..report import FAILS, NOTE, OK, Report
from ..statistics import at_most, chi_squared, directions, normal_p, rows, uniform_inputs
from ..subject import Subject

#: Number of random inputs of a test without statistics.
INPUTS = 2**14

#: Values are reflectances, not light; values whose derivatives are tested.
EMITS, SMOOTH = False, ("eval()",)

#: Angles of incidence of statistical tests, in degrees; the last is below the surface.
ANGLES = (12.0, 48.0, 77.0, 145.0)


def interaction(wi: Any, uv: Any) -> Any:
    """Returns points of a surface that are seen from the local directions ``wi``."""
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(wi))
    si.wi, si.uv, si.t, si.n = mi.Vector3f(wi), mi.Point2f(uv), mi.Float(1), mi.Normal3f(0, 0, 1)
    si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
    si.sh_frame, si.p = mi.Frame3f(si.dp_du, si.dp_dv, si.n), mi.Point3f(si.uv.x, si.uv.y, 0)
    if mi.is_spectral:
        si.wavelengths = mi.UnpolarizedSpectrum(450, 520, 590, 650)
    return si


class Queries:
    """Random inputs of a BSDF, its samples there, and directions ``out``, half of which are samples."""

    def __init__(self, bsdf: Any, mode: Any = mi.TransportMode.Radiance, n: int = INPUTS, component: int = -1) -> None:
        u = uniform_inputs(n, 6, 11)
        self.ctx = context(mode, component)
        self.wi, self.uv = directions(n, 1), u[:2]
        self.si, self.u1, self.u2 = interaction(self.wi, self.uv), mi.Float(u[2]), mi.Point2f(u[3:5])
        bs, weight = bsdf.sample(self.ctx, self.si, self.u1, self.u2)
        self.weight, self.pdf, self.wo, self.eta = (rows(v, n) for v in (weight, bs.pdf, bs.wo, bs.eta))
        self.type, self.component = (rows(v, n)[0].astype(int) for v in (bs.sampled_type, bs.sampled_component))
        self.valid = (self.pdf[0] > 0) & (self.weight > 0).any(axis=0)
        self.smooth = self.valid & ~self.has(mi.BSDFFlags.Delta)
        self.out = np.where(self.smooth & (u[5] < 0.5), self.wo, directions(n, 2)).astype(np.float32)
        self.value, self.density = (rows(v, n) for v in bsdf.eval_pdf(self.ctx, self.si, mi.Vector3f(self.out)))

    def has(self, flag: Any) -> np.ndarray:
        """Whether each sample has one of the types in ``flag``."""
        return self.type & int(flag) != 0

    def where(self, i: int) -> str:
        """The angles of input i."""
        return angles(self.wi[:, i], self.out[:, i], self.uv[:, i])

    def sampled(self, i: int) -> str:
        """The angles of input i and its sample."""
        return angles(self.wi[:, i], self.wo[:, i], self.uv[:, i])


def angles(wi: np.ndarray, wo: np.ndarray, uv: np.ndarray) -> str:
    """Describes two directions by their angles to the normal, and the difference of their azimuths."""
    theta = [np.degrees(np.arccos(np.clip(v[2], -1, 1))) for v in (wi, wo)]
    phi = np.degrees(np.arctan2(wo[1], wo[0]) - np.arctan2(wi[1], wi[0])) % 360
    return f"wi {theta[0]:.1f}°, wo {theta[1]:.1f}°, azimuth {phi:.0f}°, uv ({uv[0]:.2f}, {uv[1]:.2f})"


def context(mode: Any, component: int = -1) -> Any:
    """A context for one component, or for all if ``component`` is negative."""
    ctx = mi.BSDFContext(mode)
    if component >= 0:
        ctx.component = component
    return ctx


def contexts(bsdf: Any) -> Iterator[tuple[str, Any, int]]:
    """Yields the name, the mode and the component of each context: both transport modes, and each component alone."""
    yield "", mi.TransportMode.Radiance, -1
    yield "importance, ", mi.TransportMode.Importance, -1
    for i in range(bsdf.component_count() if bsdf.component_count() > 1 else 0):
        yield f"component {i}, ", mi.TransportMode.Radiance, i


def incidences(bsdf: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yields the name, the direction wi and uv of each incidence of a statistical test."""
    two_sided = bsdf.flags() & int(mi.BSDFFlags.BackSide | mi.BSDFFlags.Transmission)
    for i, angle in enumerate(ANGLES if two_sided else ANGLES[:-1]):
        sin, cos = float(np.sin(np.radians(angle))), float(np.cos(np.radians(angle)))
        wi, uv = mi.Vector3f(0.8 * sin, 0.6 * sin, cos), mi.Point2f(0.3 + 0.17 * i, 0.61 - 0.2 * i)
        dr.make_opaque(wi, uv)
        yield f"wi {angle:.0f}°", wi, uv


def seen(wi: Any, uv: Any, like: Any) -> Any:
    """The same interaction once for each column of ``like``."""
    return interaction(wi + dr.zeros(mi.Vector3f, dr.width(like)), uv)


def test_finite(subject: Subject, report: Report) -> None:
    """Values, densities and weights are finite and not negative, also at grazing angles and extreme numbers."""
    bsdf, flag = subject.load(), mi.BSDFFlags
    z = np.array([0, 1e-7, 1e-4, 1e-3, 0.03, 0.7, 1, -1e-7, -1e-3, -0.7, -1], dtype=np.float32)
    extremes = np.array([0, 2**-24, 0.5, 1 - 2**-24], dtype=np.float32)
    cos_i, cos_o, *u = (one.ravel() for one in np.meshgrid(z, z, extremes, extremes, extremes))
    n, uv = cos_i.size, np.array([0.3, 0.6])
    wi = np.stack([np.sqrt(1 - cos_i**2), 0 * cos_i, cos_i])
    wo = np.stack([-0.8 * np.sqrt(1 - cos_o**2), 0.6 * np.sqrt(1 - cos_o**2), cos_o])
    si = interaction(mi.Vector3f(wi), mi.Point2f(0.3, 0.6))
    bs, weight = bsdf.sample(mi.BSDFContext(), si, mi.Float(u[0]), mi.Point2f(u[1], u[2]))
    value, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, mi.Vector3f(wo))
    front, back = (bsdf.flags() & int(side) != 0 for side in (flag.FrontSide, flag.BackSide))
    inside = np.where(cos_i > 0, front, back) & (cos_i != 0) & (cos_o != 0)
    found = {name: rows(v, n) for name, v in (("eval()", value), ("pdf()", pdf), ("weight", weight), ("wo", bs.wo))}
    drawn = (rows(bs.pdf, n)[0] > 0) & (found["weight"] > 0).any(axis=0)
    for name, values in found.items():
        where = lambda i, name=name: f"{name} at {angles(wi[:, i], wo[:, i], uv)}, sample {[float(v[i]) for v in u]}"  # noqa: E731
        right = np.isfinite(values) & ((values >= 0) | (name in ("pdf()", "wo")))
        report.require("finite, not negative", right, where=where, on=inside & (drawn | (name != "wo")))
        report.require(
            "finite, also beyond the sides of flags()", np.isfinite(values) | (name == "wo"), where=where, worst=NOTE
        )
    unit = np.abs(np.linalg.norm(found["wo"], axis=0) - 1) < 1e-3
    report.require("sampled directions are unit vectors", unit, on=drawn, share=0.01)


def test_weights(subject: Subject, report: Report) -> None:
    """weight = eval() / pdf(), and eval_pdf() and eval_pdf_sample() agree with the others, in each context."""
    bsdf = subject.load()
    for name, mode, component in contexts(bsdf):
        q = Queries(bsdf, mode, component=component)
        drawn, wo = mi.Vector3f(q.wo), mi.Vector3f(q.out)
        where, sampled = (lambda i, f=f, name=name: name + f(i) for f in (q.where, q.sampled))
        value, pdf = (rows(f(q.ctx, q.si, drawn), INPUTS) for f in (bsdf.eval, bsdf.pdf))
        report.equal("weight of a sample = eval() / pdf()", q.weight * q.pdf, value, sampled, on=q.smooth)
        report.equal("pdf of a sample = pdf()", q.pdf, pdf, sampled, on=q.smooth)
        report.equal("eval_pdf() = eval(), pdf()", q.value, rows(bsdf.eval(q.ctx, q.si, wo), INPUTS), where)
        report.equal("eval_pdf() = eval(), pdf()", q.density, rows(bsdf.pdf(q.ctx, q.si, wo), INPUTS), where)
        value, pdf, bs, weight = bsdf.eval_pdf_sample(q.ctx, q.si, wo, q.u1, q.u2)
        for a, b in ((value, q.value), (pdf, q.density), (weight, q.weight), (bs.pdf, q.pdf)):
            report.equal("eval_pdf_sample() = eval(), pdf(), sample()", rows(a, INPUTS), b, where)


def test_density(subject: Subject, report: Report) -> None:
    """Directions of sample() have the density of pdf(), where the BSDF is not black."""
    bsdf, flag = subject.load(), mi.BSDFFlags
    for name, mode, component in contexts(bsdf):
        ctx, flags = context(mode, component), bsdf.flags() if component < 0 else bsdf.flags(component)
        if mode != mi.TransportMode.Radiance or not flags & int(flag.Smooth):
            continue
        for angle, wi, uv in incidences(bsdf):

            def sample(u: Any, ctx: Any = ctx, wi: Any = wi, uv: Any = uv) -> tuple[Any, Any]:
                bs, weight = bsdf.sample(ctx, seen(wi, uv, u), u[0], mi.Point2f(u[1], u[2]))
                smooth = (bs.sampled_type & int(flag.Delta)) == 0
                valid = smooth & (bs.pdf > 0) & dr.any(mi.unpolarized_spectrum(weight) > 0)
                return dr.select(valid, bs.wo, mi.Vector3f(0, 0, 1)), dr.select(valid, mi.Float(1), 0)

            def pdf(wo: Any, ctx: Any = ctx, wi: Any = wi, uv: Any = uv) -> Any:
                value, density = bsdf.eval_pdf(ctx, seen(wi, uv, wo), wo)
                return dr.select(dr.any(mi.unpolarized_spectrum(value) > 0), density, 0) + dr.zeros(
                    mi.Float, dr.width(wo)
                )

            chi_squared(report, "samples follow pdf()", name + angle, sample, pdf)


def is_fibre(bsdf: Any) -> bool:
    """Whether a lobe both reflects and transmits, as in hair, whose directions have no sides."""
    both = int(mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.GlossyTransmission)
    return any(bsdf.flags(i) & both == both for i in range(bsdf.component_count()))


def turned(bsdf: Any, q: Queries) -> np.ndarray:
    """The values after a turn of all directions about the normal."""
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]], dtype=np.float32)
    return rows(bsdf.eval(q.ctx, interaction(mi.Vector3f(turn @ q.wi), q.uv), mi.Vector3f(turn @ q.out)), q.uv.shape[1])


def moved(bsdf: Any, q: Queries) -> np.ndarray:
    """The values at other places."""
    return rows(bsdf.eval(q.ctx, interaction(mi.Vector3f(q.wi), q.uv[::-1]), mi.Vector3f(q.out)), q.uv.shape[1])


def is_tilted(bsdf: Any) -> bool:
    """Whether a map tilts the normal: the azimuth matters, and differently at different places."""
    q = Queries(bsdf, n=2**10)
    same = [np.allclose(f(bsdf, q), q.value, rtol=0.05, atol=1e-4 * q.value.mean()) for f in (turned, moved)]
    return not any(same)


def test_symmetry(subject: Subject, report: Report) -> None:
    """f(wi, wo) = f(wo, wi), where radiance one way is importance the other way; flags tell what else matters."""
    bsdf = subject.load()
    q, worst = Queries(bsdf), NOTE if is_tilted(bsdf) else FAILS
    back = bsdf.eval(context(mi.TransportMode.Importance), interaction(mi.Vector3f(q.out), q.uv), mi.Vector3f(q.wi))
    there, back = q.value / np.abs(q.out[2]), rows(back, INPUTS) / np.abs(q.wi[2])
    steep, loose = (
        np.minimum(np.abs(q.out[2]), np.abs(q.wi[2])) > 0.02,
        {"tolerance": 0.05, "share": 0.01, "floor": 0.02},
    )
    report.equal("reciprocity", there, back, q.where, on=steep, worst=NOTE if is_fibre(bsdf) else worst, **loose)
    if not bsdf.flags() & int(mi.BSDFFlags.SpatiallyVarying):
        test = "without the flag SpatiallyVarying, uv changes nothing"
        report.equal(test, moved(bsdf, q), q.value, q.where, worst=NOTE)
    if not bsdf.flags() & int(mi.BSDFFlags.Anisotropic):
        test = "without the flag Anisotropic, a turn changes nothing"
        report.equal(test, turned(bsdf, q), q.value, q.where, tolerance=0.03, worst=worst)


def test_albedo(subject: Subject, report: Report) -> None:
    """No direction reflects and transmits more than arrives; eval_diffuse_reflectance() is a part of it."""
    bsdf, n = subject.load(), 2**15
    u = uniform_inputs(n, 3, 3)
    for angle, wi, uv in incidences(bsdf):
        si = seen(wi, uv, mi.Float(u[0]))
        _, weight = bsdf.sample(context(mi.TransportMode.Importance), si, mi.Float(u[0]), mi.Point2f(u[1:]))
        weight = rows(weight, n)
        report.add("albedo at most 1", where=angle, **at_most(weight[np.argmax(weight.mean(axis=1))], 1.002))
    q = Queries(bsdf)
    value = rows(bsdf.eval_diffuse_reflectance(q.si), INPUTS)
    report.require(
        "eval_diffuse_reflectance() is in [0, 1]", (value >= 0) & (value <= 1.001), where=q.where, worst=NOTE
    )


def test_flags(subject: Subject, report: Report) -> None:
    """The flags tell what is sampled, and where the BSDF is not 0."""
    bsdf, flag = subject.load(), mi.BSDFFlags
    components = np.array([bsdf.flags(i) for i in range(bsdf.component_count())] or [0])
    union, kinds, q = int(np.bitwise_or.reduce(components)), int(flag.All), Queries(bsdf)
    own = components[np.minimum(q.component, len(components) - 1)]
    cos, fibre = q.wi[2] * q.wo[2], is_fibre(bsdf)
    reflects, passes = q.has(flag.Reflection), q.has(flag.Transmission) | q.has(flag.Null)
    opposite = np.abs(q.wo - q.wi * [[-1], [-1], [1]]).max(axis=0) < 1e-3
    sines = [np.linalg.norm(v[:2], axis=0) for v in (q.wi, q.wo)]
    for test, on, right, worst in (
        ("flags() = those of all components", True, [bsdf.flags() == union], FAILS),
        ("sampled_component is below component_count()", q.valid, q.component < len(components), NOTE),
        ("sampled_type is the type of sampled_component", q.valid, q.type & kinds & ~own == 0, NOTE),
        ("sampled_type is a lobe of flags()", q.valid, q.has(kinds) & ~q.has(kinds & ~union), FAILS),
        ("reflection stays on its side", q.valid & reflects & ~passes, cos > -1e-4, FAILS),
        ("transmission leaves its side", q.valid & passes & ~reflects, cos < 1e-4, FAILS),
        ("a null lobe goes straight on", q.valid & q.has(flag.Null), np.abs(q.wo + q.wi) < 1e-3, FAILS),
        ("eta of reflection is 1", q.valid & reflects, np.abs(q.eta - 1) < 1e-5, FAILS),
        ("ideal reflection mirrors wi", q.valid & q.has(flag.DeltaReflection), opposite, FAILS),
        (
            "ideal refraction obeys Snell's law",
            q.valid & q.has(flag.DeltaTransmission),
            np.abs(sines[0] - q.eta * sines[1]) < 2e-3,
            FAILS,
        ),
    ):
        report.require(test, right, where=q.sampled, on=on, worst=worst)
    cos, carries = q.wi[2] * q.out[2], (q.value != 0).any(axis=0)
    allowed = np.zeros(INPUTS, dtype=bool)
    for one in components[components & int(flag.Smooth) != 0]:
        side = np.where(q.wi[2] > 0, one & int(flag.FrontSide), one & int(flag.BackSide)) != 0
        allowed |= side & (np.where(cos > 0, one & int(flag.Reflection), one & int(flag.Transmission)) != 0)
    report.require(
        "eval() is 0 where the flags have no lobe", ~carries | allowed, where=q.where, worst=NOTE if fibre else FAILS
    )
    report.require("pdf() is 0 where eval() is 0", (q.density == 0) | carries, where=q.where, share=0.01, worst=NOTE)
    for one in components:
        found = (q.has(one & kinds) & (q.pdf[0] > 0)).any()
        report.add(
            "every lobe of the flags is sampled", OK if found else FAILS, "" if found else f"never {one & kinds:#x}"
        )


def test_components(subject: Subject, report: Report) -> None:
    """The values of the components add up to the whole."""
    bsdf = subject.load()
    q, count = Queries(bsdf), bsdf.component_count()
    if count < 2:
        return
    ctxs = [context(mi.TransportMode.Radiance, i) for i in range(count)]
    parts = [rows(bsdf.eval(ctx, q.si, mi.Vector3f(q.out)), INPUTS) for ctx in ctxs]
    if q.value.any() and all(np.allclose(part, q.value) for part in parts):
        report.add("components add up to the whole", NOTE, "the BSDF ignores the context's component")
    else:
        report.equal("components add up to the whole", sum(parts), q.value, q.where)


def test_ideal_lobes(subject: Subject, report: Report) -> None:
    """Ideal lobes have their probability."""
    bsdf, delta, n = subject.load(), int(mi.BSDFFlags.Delta), 2**14
    u = uniform_inputs(n, 3, 5)
    for angle, wi, uv in incidences(bsdf) if bsdf.flags() & delta else ():
        bs, _ = bsdf.sample(mi.BSDFContext(), seen(wi, uv, mi.Float(u[0])), mi.Float(u[0]), mi.Point2f(u[1:]))
        pdf, ideal = rows(bs.pdf, n)[0], rows(bs.sampled_type, n)[0].astype(int) & delta != 0
        for stated in np.unique(pdf[ideal & (pdf > 0)].round(4)):
            share = float((ideal & (np.abs(pdf - stated) < 1e-4)).mean())
            error = max(np.sqrt(max(stated * (1 - stated), 0) / n), 1e-4)
            p = normal_p(max(0.0, abs(share - stated) - 1e-3) / error)
            text = f"{share:.4f} of the samples, pdf {stated:.4f}"
            report.add("ideal lobes have their probability", OK, text, angle, p_value=p)


def test_refraction(subject: Subject, report: Report) -> None:
    """The weights of radiance and importance differ by eta squared, and a facet refracts wi to wo."""
    bsdf = subject.load()
    if not bsdf.flags() & int(mi.BSDFFlags.Transmission):
        return
    q, other = Queries(bsdf), Queries(bsdf, mi.TransportMode.Importance)
    same = q.valid & other.valid & (np.abs(q.wo - other.wo).max(axis=0) < 1e-3)
    report.equal("radiance = importance / eta²", q.weight, other.weight / q.eta**2, q.sampled, on=same)
    half = q.wi + q.eta * q.wo
    cosines = [(half * v).sum(axis=0) * v[2] * half[2] for v in (q.wi, q.wo)]
    refracts = q.valid & (np.abs(q.eta[0] - 1) > 1e-3) & (np.abs(q.wi[2]) > 0.05) & (np.abs(q.wo[2]) > 0.05)
    report.require("a facet refracts wi to wo", np.array(cosines) > -1e-4, where=q.sampled, on=refracts, share=0.02)


def test_indices(subject: Subject, report: Report) -> None:
    """Light that enters from the front meets the index int_ior / ext_ior, where these are parameters."""
    try:
        q = Queries(subject.load(int_ior=1.9, ext_ior=1.2))
    except RuntimeError:
        return
    enters = q.valid & (q.wi[2] > 0) & (q.wo[2] < 0) & (q.eta[0] != 1)
    report.equal("eta from the front = int_ior / ext_ior", q.eta, 1.9 / 1.2, q.sampled, on=enters)


def test_inactive(subject: Subject, report: Report) -> None:
    """Inactive lanes have no value, no density and no weight."""
    bsdf = subject.load()
    q, lanes = Queries(bsdf), np.arange(INPUTS) % 2 == 1
    value, pdf = bsdf.eval_pdf(q.ctx, q.si, mi.Vector3f(q.out), mi.Bool(~lanes))
    _, weight = bsdf.sample(q.ctx, q.si, q.u1, q.u2, mi.Bool(~lanes))
    for name, found, worst in (("eval()", value, FAILS), ("pdf()", pdf, NOTE), ("sample()", weight, NOTE)):
        report.require(f"{name} is 0 in inactive lanes", rows(found, INPUTS) == 0, where=q.where, on=lanes, worst=worst)


def prepare(bsdf: Any) -> Any:
    """A BSDF needs no scene."""
    return bsdf


def inputs(n: int) -> list[np.ndarray]:
    """Two directions, uv and uniform numbers; two of three pairs of directions are on one side."""
    u = 0.02 + 0.96 * uniform_inputs(n, 5, 71)
    wi, wo = directions(n, 72), directions(n, 73)
    wo[2] *= np.sign(wo[2] * wi[2]) * np.where(np.arange(n) % 3 == 0, -1, 1)
    return [wi, wo, u[:2], u[2:3], u[3:]]


def values(bsdf: Any, wi: Any, wo: Any, uv: Any, u1: Any, u2: Any, wavelengths: Any) -> dict[str, Any]:
    """Values, densities and weights at given inputs."""
    si, ctx = interaction(wi, uv), mi.BSDFContext()
    si.wavelengths = wavelengths if mi.is_spectral else si.wavelengths
    value, pdf = bsdf.eval_pdf(ctx, si, wo)
    bs, weight = bsdf.sample(ctx, si, u1, u2)
    return {"eval()": value, "pdf()": pdf, "weight times pdf of sample()": dr.select(bs.pdf > 0, weight * bs.pdf, 0)}


TESTS = (
    test_finite, test_weights, test_flags, test_density, test_ideal_lobes, test_refraction, test_components,
    test_symmetry, test_albedo, test_indices, test_inactive,
)  # fmt: skip
