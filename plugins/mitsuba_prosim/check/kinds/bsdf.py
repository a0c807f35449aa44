"""Tests of a BSDF."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..report import FAILS, NOTE, OK, Report
from ..statistics import chi_squared, directions, normal_p, spectrum, uniform_inputs
from ..subject import Subject

#: Number of random inputs of a test without statistics.
INPUTS = 2**14

#: Values are reflectances, not light; values whose derivatives are tested.
EMITS, SMOOTH = False, ("eval()",)

#: Angles of incidence of chi-squared tests, in degrees.
ANGLES = (12.0, 48.0, 77.0)


def interaction(wi: Any, uv: Any) -> Any:
    """Returns points of a surface that are seen from the local directions ``wi``."""
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(wi))
    si.wi, si.uv, si.t = mi.Vector3f(wi), mi.Point2f(uv), mi.Float(1)
    si.n = mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0), mi.Vector3f(0, 0, 1))
    si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
    si.p = mi.Point3f(si.uv.x, si.uv.y, 0)
    if mi.is_spectral:
        si.wavelengths = mi.UnpolarizedSpectrum(450, 520, 590, 650)
    return si


class Queries:
    """Random inputs of a BSDF, its samples there, and the values that belong to the samples."""

    def __init__(self, bsdf: Any, ctx: Any, n: int = INPUTS, seed: int = 1) -> None:
        self.bsdf, self.ctx = bsdf, ctx
        u = uniform_inputs(n, 6, seed + 10)
        self.wi, other = directions(n, seed), directions(n, seed + 1)
        self.uv = u[:2]
        self.si = interaction(mi.Vector3f(self.wi), mi.Point2f(self.uv))
        self.u1, self.u2 = mi.Float(u[2]), mi.Point2f(u[3:5])
        self.bs, weight = bsdf.sample(ctx, self.si, self.u1, self.u2)
        self.weight, self.pdf = spectrum(weight), np.broadcast_to(np.array(self.bs.pdf), n)
        self.wo = np.broadcast_to(np.array(self.bs.wo), (3, n)).astype(np.float32)
        types = np.broadcast_to(np.array(self.bs.sampled_type), n)
        self.types = types.astype(np.int64) & 0xFFFFFFFF
        self.eta = np.broadcast_to(np.array(self.bs.eta), n)
        self.weight = np.broadcast_to(self.weight, (self.weight.shape[0], n))
        sides = [int(mi.BSDFFlags.FrontSide), int(mi.BSDFFlags.BackSide)]
        front, back = ((bsdf.flags() & side) != 0 for side in sides)
        #: Whether the BSDF has a side there.
        self.sided = np.where(self.wi[2] > 0, front, back)
        self.valid = (self.pdf > 0) & (self.weight > 0).any(axis=0)
        self.delta = (self.types & int(mi.BSDFFlags.Delta)) != 0
        #: Directions at which the BSDF is evaluated: half of them are samples.
        use = self.valid & ~self.delta & (u[5] < 0.5)
        self.out = np.where(use, self.wo, other).astype(np.float32)

    def where(self, i: int) -> str:
        """The angles of input i."""
        return angles(self.wi[:, i], self.out[:, i], self.uv[:, i])

    def where_sampled(self, i: int) -> str:
        """The angles of input i and its sample."""
        return angles(self.wi[:, i], self.wo[:, i], self.uv[:, i])


def angles(wi: np.ndarray, wo: np.ndarray, uv: np.ndarray) -> str:
    """Describes two directions by their angles to the normal, and the difference of their azimuths."""
    theta = [np.degrees(np.arccos(np.clip(v[2], -1, 1))) for v in (wi, wo)]
    phi = np.degrees(np.arctan2(wo[1], wo[0]) - np.arctan2(wi[1], wi[0])) % 360
    return f"wi {theta[0]:.1f}°, wo {theta[1]:.1f}°, azimuth {phi:.0f}°, uv ({uv[0]:.2f}, {uv[1]:.2f})"


def contexts(bsdf: Any) -> Iterator[tuple[str, Any]]:
    """Yields the names and contexts in which a BSDF is sampled: both transport modes, and each component alone."""
    yield "", mi.BSDFContext()
    yield "importance, ", mi.BSDFContext(mi.TransportMode.Importance)
    if bsdf.component_count() > 1:
        for i in range(bsdf.component_count()):
            ctx = mi.BSDFContext()
            ctx.component = i
            yield f"component {i}, ", ctx


def test_samples_follow_pdf(subject: Subject, report: Report) -> None:
    """Directions of sample() have the density of pdf()."""
    bsdf = subject.load()
    if not bsdf.flags() & mi.BSDFFlags.Smooth:
        return
    null = bsdf.flags() & int(mi.BSDFFlags.Null)
    back = bsdf.flags() & (mi.BSDFFlags.BackSide | mi.BSDFFlags.Transmission)
    for name, ctx in contexts(bsdf):
        if "importance" in name or (ctx.component < 2**31 and not bsdf.flags(ctx.component) & mi.BSDFFlags.Smooth):
            continue
        for number, angle in enumerate((*ANGLES, 180 - 35.0) if back else ANGLES):
            t = np.radians(angle)
            wi = mi.Vector3f(float(0.8 * np.sin(t)), float(0.6 * np.sin(t)), float(np.cos(t)))
            uv = mi.Point2f(0.3 + 0.17 * number, 0.61 - 0.2 * number)
            dr.make_opaque(wi, uv)

            def sample(u: Any, ctx: Any = ctx, wi: Any = wi, uv: Any = uv) -> tuple[Any, Any]:
                bs, weight = bsdf.sample(ctx, interaction(at(wi, u), uv), u[0], mi.Point2f(u[1], u[2]))
                smooth = (bs.sampled_type & int(mi.BSDFFlags.Delta)) == 0
                valid = smooth & (bs.pdf > 0) & dr.any(mi.unpolarized_spectrum(weight) > 0)
                return dr.select(valid, bs.wo, mi.Vector3f(0, 0, 1)), dr.select(valid, mi.Float(1), 0)

            def pdf(wo: Any, ctx: Any = ctx, wi: Any = wi, uv: Any = uv) -> Any:
                value, density = bsdf.eval_pdf(ctx, interaction(at(wi, wo), uv), wo)
                carries = dr.any(mi.unpolarized_spectrum(value) > 0)
                return dr.select(carries, density, 0) + dr.zeros(mi.Float, dr.width(wo))

            # The mask samples the wrong half if the context asks for one component (3.9).
            worst = NOTE if name and null else FAILS
            chi_squared(report, "samples follow pdf()", f"{name}wi {angle:.0f}°", sample, pdf, worst=worst)


def at(wi: Any, like: Any) -> Any:
    """The direction ``wi`` once for each column of ``like``."""
    return wi + dr.zeros(mi.Vector3f, dr.width(like))


def test_weights(subject: Subject, report: Report) -> None:
    """The weight of a sample is eval() / pdf(), in both transport modes and for each component."""
    bsdf = subject.load()
    for name, ctx in contexts(bsdf):
        q = Queries(bsdf, ctx)
        smooth = q.valid & ~q.delta
        if not smooth.any():
            continue
        wo = mi.Vector3f(q.wo)
        value = spectrum(bsdf.eval(ctx, q.si, wo))
        pdf = np.broadcast_to(np.array(bsdf.pdf(ctx, q.si, wo)), q.pdf.shape)
        where = lambda i, q=q, name=name: name + q.where_sampled(i)  # noqa: E731
        report.equal(
            "weight of a sample = eval() / pdf()",
            (q.weight * q.pdf)[:, smooth],
            value[:, smooth],
            at_(where, smooth),
            tolerance=0.02,
        )
        report.equal("pdf of a sample = pdf()", q.pdf[smooth], pdf[smooth], at_(where, smooth), tolerance=0.02)


def at_(where: Callable[[int], str], mask: np.ndarray) -> Callable[[int], str]:
    """``where`` for the numbers among the inputs that ``mask`` selects."""
    chosen = np.flatnonzero(mask)
    return lambda i: where(int(chosen[i]))


def test_joint_methods(subject: Subject, report: Report) -> None:
    """eval_pdf() and eval_pdf_sample() return what eval(), pdf() and sample() return."""
    bsdf = subject.load()
    for name, ctx in contexts(bsdf):
        q = Queries(bsdf, ctx)
        wo = mi.Vector3f(q.out)
        where = lambda i, q=q, name=name: name + q.where(i)  # noqa: E731
        value, pdf = spectrum(bsdf.eval(ctx, q.si, wo)), np.array(bsdf.pdf(ctx, q.si, wo))
        value2, pdf2 = bsdf.eval_pdf(ctx, q.si, wo)
        report.equal("eval_pdf() = eval(), pdf()", spectrum(value2), value, where)
        report.equal("eval_pdf() = eval(), pdf()", np.array(pdf2), pdf, where)
        value3, pdf3, bs, weight = bsdf.eval_pdf_sample(ctx, q.si, wo, q.u1, q.u2)
        report.equal("eval_pdf_sample() = eval(), pdf(), sample()", spectrum(value3), value, where)
        report.equal("eval_pdf_sample() = eval(), pdf(), sample()", np.array(pdf3), pdf, where)
        report.equal("eval_pdf_sample() = eval(), pdf(), sample()", spectrum(weight), q.weight, where)
        report.equal("eval_pdf_sample() = eval(), pdf(), sample()", np.array(bs.pdf), q.pdf, where)


def test_finite(subject: Subject, report: Report) -> None:
    """Values, densities and weights are finite and not negative, also at grazing angles and extreme numbers."""
    bsdf = subject.load()
    z = np.array([0, 1e-7, 1e-4, 1e-3, 0.03, 0.7, 1, -1e-7, -1e-3, -0.7, -1], dtype=np.float32)
    u = np.array([0, 2**-24, 0.5, 1 - 2**-24], dtype=np.float32)
    grid = np.stack([one.ravel() for one in np.meshgrid(z, z, u, u, u)])
    wi, wo = (
        np.stack([np.sqrt(1 - c * c) * a, np.sqrt(1 - c * c) * b, c])
        for c, a, b in ((grid[0], 1, 0), (grid[1], -0.8, 0.6))
    )
    flags = bsdf.flags()
    sided = np.where(wi[2] > 0, flags & int(mi.BSDFFlags.FrontSide) != 0, flags & int(mi.BSDFFlags.BackSide) != 0)
    edge = (grid[0] == 0) | (grid[1] == 0)
    si = interaction(mi.Vector3f(wi), mi.Point2f(0.3, 0.6))
    bs, weight = bsdf.sample(mi.BSDFContext(), si, mi.Float(grid[2]), mi.Point2f(grid[3:]))
    value, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, mi.Vector3f(wo))
    valid = (np.array(bs.pdf) > 0) & (spectrum(weight) > 0).any(axis=0)
    length = np.linalg.norm(np.broadcast_to(np.array(bs.wo), wo.shape), axis=0)
    where = lambda i: f"{angles(wi[:, i], wo[:, i], np.array([0.3, 0.6]))}, sample {grid[2:, i].round(3).tolist()}"  # noqa: E731
    for what, values in (
        ("eval()", spectrum(value)),
        ("pdf()", np.array(pdf)),
        ("the weight", spectrum(weight)),
        ("the density of a sample", np.where(valid, np.array(bs.pdf), 0)),
    ):
        values = np.broadcast_to(np.atleast_2d(values), (np.atleast_2d(values).shape[0], grid.shape[1]))
        finite = np.isfinite(values).all(axis=0)
        right = finite & ((values >= 0).all(axis=0) | (what == "pdf()"))
        report.require("finite, not negative", right | edge | ~sided, f"{what} is not", where)
        report.require("finite, also beyond the sides of flags()", finite, f"{what} is not", where, worst=NOTE)
    report.require(
        "sampled directions are unit vectors", ~valid | (np.abs(length - 1) < 1e-3), "|wo| is not 1", where, 0.01
    )


def is_fibre(bsdf: Any) -> bool:
    """Whether a lobe both reflects and transmits, as in hair, whose directions have no sides."""
    both = int(mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.GlossyTransmission)
    return any(bsdf.flags(i) & both == both for i in range(bsdf.component_count()))


def is_tilted(bsdf: Any) -> bool:
    """Whether a map tilts the normal: the azimuth matters, and differently at different places."""
    q = Queries(bsdf, mi.BSDFContext(), 2**10)
    turned = interaction(mi.Vector3f(q.wi * [[-1], [-1], [1]]), mi.Point2f(q.uv))
    moved = interaction(mi.Vector3f(q.wi), mi.Point2f(q.uv[::-1]))
    value = spectrum(bsdf.eval(q.ctx, q.si, mi.Vector3f(q.out)))
    others = (
        bsdf.eval(q.ctx, turned, mi.Vector3f(q.out * [[-1], [-1], [1]])),
        bsdf.eval(q.ctx, moved, mi.Vector3f(q.out)),
    )
    return all(not np.allclose(spectrum(other), value, rtol=0.05, atol=1e-4 * value.mean()) for other in others)


def test_reciprocity(subject: Subject, report: Report) -> None:
    """f(wi, wo) = f(wo, wi); through an interface, radiance one way is importance the other way."""
    bsdf = subject.load()
    q = Queries(bsdf, mi.BSDFContext())
    wi, wo = mi.Vector3f(q.wi), mi.Vector3f(q.out)
    there = spectrum(bsdf.eval(q.ctx, q.si, wo)) / np.abs(q.out[2])
    back = bsdf.eval(mi.BSDFContext(mi.TransportMode.Importance), interaction(wo, q.si.uv), wi)
    back = spectrum(back) / np.abs(q.wi[2])
    well = np.minimum(np.abs(q.out[2]), np.abs(q.wi[2])) > 0.02
    worst = NOTE if is_fibre(bsdf) or is_tilted(bsdf) else FAILS
    report.equal(
        "reciprocity",
        there[:, well],
        back[:, well],
        at_(q.where, well),
        tolerance=0.05,
        share=0.01,
        floor=0.02,
        worst=worst,
    )


def test_albedo(subject: Subject, report: Report) -> None:
    """No direction reflects and transmits more than arrives."""
    bsdf = subject.load()
    n = 2**15
    for angle in (0.1, *ANGLES, 88.0, 180 - 35.0):
        t = np.radians(angle)
        for k, (x, y) in enumerate(((0.3, 0.61), (0.8, 0.13))):
            wi, uv = mi.Vector3f(float(np.sin(t)), 0, float(np.cos(t))), mi.Point2f(x, y)
            dr.make_opaque(wi, uv)
            u = uniform_inputs(n, 3, 3 + k)
            ctx = mi.BSDFContext(mi.TransportMode.Importance)
            _, weight = bsdf.sample(ctx, interaction(at(wi, mi.Float(u[0])), uv), mi.Float(u[0]), mi.Point2f(u[1:]))
            weight = np.broadcast_to(spectrum(weight), (spectrum(weight).shape[0], n))
            albedo, error = weight.mean(axis=1), weight.std(axis=1) / n**0.5
            i = int(np.argmax(albedo))
            beyond = max(0.0, albedo[i] - 1.002) / max(error[i], 1e-9)
            p = normal_p(beyond) if beyond > 0 else 1.0
            report.add(
                "albedo at most 1", statistic=f"{albedo[i]:.4f}", where=f"wi {angle:.0f}°, uv ({x}, {y})", p_value=p
            )


def test_flags(subject: Subject, report: Report) -> None:
    """The flags tell what is sampled, and where the BSDF is not 0."""
    bsdf, ctx, flag = subject.load(), mi.BSDFContext(), mi.BSDFFlags
    components = [bsdf.flags(i) for i in range(bsdf.component_count())]
    union = 0
    for one in components:
        union |= one
    report.require("flags() = those of all components", [bsdf.flags() == union or not components], "other flags")
    q = Queries(bsdf, ctx)
    kinds = int(flag.All)
    cos_i, cos_o = q.wi[2], q.wo[2]
    where = q.where_sampled
    number = np.broadcast_to(np.array(q.bs.sampled_component), q.pdf.shape).astype(np.int64)
    types = [int(one) & kinds for one in components]
    inside = number < max(1, len(components))
    report.require("sampled_component is below component_count()", ~q.valid | inside, "it is not", where, worst=NOTE)
    declared = np.array(types or [0])[np.where(inside, number, 0)]
    fits = (q.types & kinds & ~declared) == 0
    report.require("sampled_type is the type of sampled_component", ~q.valid | fits, "it is not", where, worst=NOTE)
    known = ((q.types & kinds) != 0) & ((q.types & kinds & ~union) == 0)
    report.require("sampled_type is a lobe of flags()", ~q.valid | known, "it is not", where)
    reflects, passes = (q.types & int(flag.Reflection)) != 0, (q.types & int(flag.Transmission)) != 0
    null = (q.types & int(flag.Null)) != 0
    steep = np.abs(cos_i * cos_o) > 1e-4
    side = np.where(
        reflects & passes, True, np.where(reflects, cos_i * cos_o > 0, np.where(passes | null, cos_i * cos_o < 0, True))
    )
    report.require(
        "reflection stays on the side, transmission leaves it", ~(q.valid & steep) | side, "it does not", where
    )
    straight = np.abs(q.wo + q.wi).max(axis=0) < 1e-3
    report.require("a null lobe goes straight on", ~(q.valid & null) | straight, "it does not", where)
    one = np.abs(q.eta - 1) < 1e-5
    report.require("eta of reflection is 1", ~(q.valid & reflects) | one, "it is not", where)
    mirrored = np.abs(q.wo - q.wi * [[-1], [-1], [1]]).max(axis=0) < 1e-3
    is_mirror = (q.types & int(flag.DeltaReflection)) != 0
    report.require("ideal reflection mirrors wi", ~(q.valid & is_mirror) | mirrored, "it does not", where, 0.0)
    value, pdf = bsdf.eval_pdf(ctx, q.si, mi.Vector3f(q.out))
    cos = q.wi[2] * q.out[2]
    allowed = np.zeros(q.pdf.shape, dtype=bool)
    for one_ in components:
        sides = ((one_ & int(flag.FrontSide)) != 0) & (q.wi[2] > 0) | ((one_ & int(flag.BackSide)) != 0) & (q.wi[2] < 0)
        if not one_ & int(flag.Smooth):
            continue
        reflection = one_ & int(flag.DiffuseReflection | flag.GlossyReflection)
        transmission = one_ & int(flag.DiffuseTransmission | flag.GlossyTransmission)
        allowed |= sides & ((cos > 0) if reflection else False) | sides & ((cos < 0) if transmission else False)
    value, pdf = (spectrum(value) != 0).any(axis=0), np.array(pdf) != 0
    worst = NOTE if is_fibre(bsdf) else FAILS
    report.require("eval() is 0 where the flags have no lobe", ~value | allowed, "it is not", q.where, worst=worst)
    report.require("pdf() is 0 where eval() is 0", ~pdf | value, "it is not", q.where, 0.01, worst=NOTE)
    sampled = np.unique(q.types[q.valid] & kinds)
    for i, type_ in enumerate(types):
        report_missing(report, bsdf, q, i, type_, sampled)


def report_missing(report: Report, bsdf: Any, q: Queries, i: int, type_: int, sampled: np.ndarray) -> None:
    """Adds whether the lobe ``type_`` of component ``i`` is ever sampled."""
    name = " | ".join(str(f).rpartition(".")[2] for f in mi.BSDFFlags if int(f) & type_ and int(f) & int(f) - 1 == 0)
    found = any(int(s) & type_ for s in sampled)
    report.add("every lobe of the flags is sampled", "ok" if found else NOTE, "" if found else f"never {name}")


def test_components(subject: Subject, report: Report) -> None:
    """The values of the components add up to the whole."""
    bsdf = subject.load()
    if bsdf.component_count() < 2:
        return
    q = Queries(bsdf, mi.BSDFContext())
    wo = mi.Vector3f(q.out)
    whole = spectrum(bsdf.eval(q.ctx, q.si, wo))
    parts = []
    for i in range(bsdf.component_count()):
        ctx = mi.BSDFContext()
        ctx.component = i
        parts.append(np.broadcast_to(spectrum(bsdf.eval(ctx, q.si, wo)), whole.shape))
    if whole.any() and all(np.allclose(part, whole) for part in parts):
        report.add("components add up to the whole", NOTE, "the BSDF ignores the context's component")
        return
    report.equal("components add up to the whole", sum(parts), whole, q.where)


def test_delta_lobes(subject: Subject, report: Report) -> None:
    """Ideal lobes have their probability, are reciprocal, and obey Snell's law."""
    bsdf = subject.load()
    flag = mi.BSDFFlags
    if not bsdf.flags() & int(flag.Delta):
        return
    ideal = [f for f in map(bsdf.flags, range(bsdf.component_count())) if f & int(flag.Delta)]
    kinds = [f & int(flag.Delta) for f in ideal]
    twice = len(set(kinds)) < len(kinds)  # a blend of two mirrors samples one, and its pdf means the other, too (3.9)
    n = 2**14
    u = uniform_inputs(n, 3, 5)
    for angle in (*ANGLES, 180 - 35.0, 180 - 65.0):
        t = np.radians(angle)
        wi = mi.Vector3f(float(0.8 * np.sin(t)), float(0.6 * np.sin(t)), float(np.cos(t)))
        dr.make_opaque(wi)
        si = interaction(at(wi, mi.Float(u[0])), mi.Point2f(0.3, 0.6))
        bs, _ = bsdf.sample(mi.BSDFContext(), si, mi.Float(u[0]), mi.Point2f(u[1:]))
        types = np.broadcast_to(np.array(bs.sampled_type), n) & np.int64(int(flag.Delta))
        pdfs = np.broadcast_to(np.array(bs.pdf), n)
        for pdf in np.unique(pdfs[(types != 0) & (pdfs > 0)].round(4)):
            chosen = (types != 0) & (np.abs(pdfs - pdf) < 1e-4)
            share = float(chosen.mean())
            error = max(np.sqrt(max(pdf * (1 - pdf), 0) / n), 1e-4)
            text, p = f"{share:.4f} of the samples, pdf {pdf:.4f}", normal_p(max(0.0, abs(share - pdf) - 1e-3) / error)
            report.add(
                "ideal lobes have their probability",
                NOTE if twice and p < 1e-6 else OK,
                text,
                f"wi {angle:.0f}°",
                p_value=p,
            )
    q = Queries(bsdf, mi.BSDFContext())
    passes = q.valid & ((q.types & int(flag.DeltaTransmission)) != 0)
    sines = [np.linalg.norm(v[:2], axis=0) for v in (q.wi, q.wo)]
    right = np.abs(sines[0] - q.eta * sines[1]) < 2e-3
    report.require("ideal refraction obeys Snell's law", ~passes | right, "sin(wi) is not eta sin(wo)", q.where_sampled)


def test_adjoint(subject: Subject, report: Report) -> None:
    """The weights of radiance and importance differ by eta squared; the way back has the inverse eta."""
    bsdf = subject.load()
    if not bsdf.flags() & int(mi.BSDFFlags.Transmission):
        return
    q = Queries(bsdf, mi.BSDFContext())
    other = Queries(bsdf, mi.BSDFContext(mi.TransportMode.Importance))
    same = q.valid & other.valid & (np.abs(q.wo - other.wo).max(axis=0) < 1e-3)
    expected = other.weight / q.eta**2
    report.equal("radiance = importance / eta²", q.weight[:, same], expected[:, same], at_(q.where_sampled, same))
    refracts = q.valid & (np.abs(q.eta - 1) > 1e-3) & (np.abs(q.wi[2]) > 0.05) & (np.abs(q.wo[2]) > 0.05)
    if refracts.any():
        half = q.wi + q.eta * q.wo
        half *= np.sign(half[2])
        cos_i, cos_o = (half * q.wi).sum(axis=0) * q.wi[2], (half * q.wo).sum(axis=0) * q.wo[2]
        valid = ~refracts | (cos_i > -1e-4) & (cos_o > -1e-4)
        report.require("refraction fits eta", valid, "no facet refracts wi to wo", q.where_sampled, 0.02)


def test_inactive(subject: Subject, report: Report) -> None:
    """Inactive lanes have no value, no density and no weight."""
    bsdf = subject.load()
    q = Queries(bsdf, mi.BSDFContext())
    active = mi.Bool(np.arange(INPUTS) % 2 == 0)
    lanes = np.arange(INPUTS) % 2 == 1
    _, weight = bsdf.sample(q.ctx, q.si, q.u1, q.u2, active)
    value, pdf = bsdf.eval_pdf(q.ctx, q.si, mi.Vector3f(q.out), active)
    for what, values in (("eval()", spectrum(value)), ("pdf()", np.array(pdf)), ("sample()", spectrum(weight))):
        values = np.broadcast_to(np.atleast_2d(values), (np.atleast_2d(values).shape[0], INPUTS))
        zero = ~lanes | (values == 0).all(axis=0)
        report.require(
            f"{what} is 0 in inactive lanes", zero, "it is not", q.where, worst=FAILS if what == "eval()" else NOTE
        )


def test_diffuse_reflectance(subject: Subject, report: Report) -> None:
    """eval_diffuse_reflectance() is in [0, 1], and the albedo of a BSDF that only reflects diffusely."""
    bsdf = subject.load()
    q = Queries(bsdf, mi.BSDFContext())
    value = spectrum(bsdf.eval_diffuse_reflectance(q.si))
    value = np.broadcast_to(value, (value.shape[0], INPUTS))
    right = ((value >= 0) & (value <= 1.001)).all(axis=0)
    report.require("eval_diffuse_reflectance() is in [0, 1]", right, "it is not", q.where, worst=NOTE)
    kinds = bsdf.flags() & int(mi.BSDFFlags.All)
    if kinds == int(mi.BSDFFlags.DiffuseReflection) and not bsdf.flags() & int(mi.BSDFFlags.BackSide):
        report.equal(
            "weight of a diffuse sample = eval_diffuse_reflectance()",
            q.weight[:, q.valid],
            value[:, q.valid],
            at_(q.where, q.valid),
            worst=NOTE,
        )


def test_variation(subject: Subject, report: Report) -> None:
    """A BSDF that varies with uv, or with the azimuth, says so by its flags."""
    bsdf, ctx = subject.load(), mi.BSDFContext()
    q = Queries(bsdf, ctx)
    wo = mi.Vector3f(q.out)
    value = spectrum(bsdf.eval(ctx, q.si, wo))
    worst = NOTE if is_tilted(bsdf) else FAILS
    if not bsdf.flags() & int(mi.BSDFFlags.SpatiallyVarying):
        other = spectrum(bsdf.eval(ctx, interaction(mi.Vector3f(q.wi), mi.Point2f(q.uv[::-1])), wo))
        report.equal("without the flag SpatiallyVarying, uv changes nothing", other, value, q.where, worst=NOTE)
    if not bsdf.flags() & int(mi.BSDFFlags.Anisotropic):
        c, s = np.cos(1.0), np.sin(1.0)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], dtype=np.float32)
        si = interaction(mi.Vector3f(turn @ q.wi), mi.Point2f(q.uv))
        other = spectrum(bsdf.eval(ctx, si, mi.Vector3f(turn @ q.out)))
        report.equal(
            "without the flag Anisotropic, a turn changes nothing", other, value, q.where, tolerance=0.03, worst=worst
        )


def inputs(n: int) -> list[np.ndarray]:
    """Two directions, uv and uniform numbers; half of the directions are on one side."""
    u = 0.02 + 0.96 * uniform_inputs(n, 5, 71)
    wi, wo = directions(n, 72), directions(n, 73)
    wo[2] *= np.sign(wo[2] * wi[2]) * np.where(np.arange(n) % 3 == 0, -1, 1)
    return [wi, wo, u[:2], u[2:3], u[3:]]


def prepare(bsdf: Any) -> Any:
    """A BSDF needs no scene."""
    return bsdf


def values(bsdf: Any, wi: Any, wo: Any, uv: Any, u1: Any, u2: Any, wavelengths: Any) -> dict[str, Any]:
    """Values, densities and weights at given inputs."""
    si, ctx = interaction(wi, uv), mi.BSDFContext()
    if mi.is_spectral:
        si.wavelengths = wavelengths
    value, pdf = bsdf.eval_pdf(ctx, si, wo)
    bs, weight = bsdf.sample(ctx, si, u1, u2)
    return {"eval()": value, "pdf()": pdf, "weight times pdf of sample()": dr.select(bs.pdf > 0, weight * bs.pdf, 0)}


TESTS: tuple[Callable[[Subject, Report], None], ...] = (
    test_finite,
    test_weights,
    test_joint_methods,
    test_flags,
    test_samples_follow_pdf,
    test_delta_lobes,
    test_adjoint,
    test_components,
    test_reciprocity,
    test_albedo,
    test_inactive,
    test_variation,
    test_diffuse_reflectance,
)
