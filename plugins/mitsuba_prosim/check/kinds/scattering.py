"""Tests of what scatters light: BSDFs, phase functions and media."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..inputs import contexts, directions, interaction, lit, rows, rows_of, surface, uniform
from ..report import FAILS, NOTE
from ..subject import OnCopies
from ..tests import Tests

#: Number of random inputs of a test without statistics, and of samples of a mean.
INPUTS, SAMPLES = 2**14, 2**16

#: Angles of incidence of statistical tests, in degrees; the last is below the surface.
ANGLES = (12.0, 48.0, 77.0, 145.0)


class Queries:
    """Random inputs of a BSDF, its samples there, and directions ``out``, half of which are samples.

    If ``extreme``, directions are also near the horizon, and uniform numbers are those at the ends of their range.
    """

    def __init__(self, bsdf: Any, ctx: Any = None, n: int = INPUTS, extreme: bool = False) -> None:
        u, self.wi, other = uniform(n, 6, 11), directions(n, 1), directions(n, 2)
        if extreme:
            u[2:5] = np.array([0, 2**-24, 0.5, 1 - 2**-24])[(4 * u[2:5]).astype(int)]
            for d in (self.wi, other):
                d[2, 1::2] *= 1e-6
                d /= np.linalg.norm(d, axis=0)
        self.ctx, self.uv = ctx or mi.BSDFContext(), u[:2]
        self.si, self.u1, self.u2 = surface(self.wi, self.uv), mi.Float(u[2]), mi.Point2f(u[3:5])
        bs, weight = bsdf.sample(self.ctx, self.si, self.u1, self.u2)
        self.sent = weight
        sampled = weight, bs.pdf, bs.wo, bs.eta, bs.sampled_type, bs.sampled_component
        self.weight, self.pdf, self.wo, self.eta, *kinds = rows_of(sampled, n)
        self.type, self.lobe = (v[0].astype(int) for v in kinds)
        self.valid = (self.pdf[0] > 0) & (self.weight > 0).any(axis=0)
        self.smooth = self.valid & ~self.has(mi.BSDFFlags.Delta)
        self.out = np.where(self.smooth & (u[5] < 0.5) & ~extreme, self.wo, other).astype(np.float32)
        self.value, self.density = rows_of(bsdf.eval_pdf(self.ctx, self.si, mi.Vector3f(self.out)), n)
        self.where, self.sampled = {"wi": self.wi, "wo": self.out}, {"wi": self.wi, "wo": self.wo}

    def has(self, flag: Any) -> np.ndarray:
        """Whether each sample has one of the types in ``flag``."""
        return self.type & int(flag) != 0


def incidences(bsdf: Any) -> Iterator[tuple[str, Callable[[int], Any]]]:
    """Yields the name of each incidence of a statistical test, and a function that returns n points of a surface."""
    two_sided = bsdf.flags() & int(mi.BSDFFlags.BackSide | mi.BSDFFlags.Transmission)
    for i, angle in enumerate(ANGLES if two_sided else ANGLES[:-1]):
        sin, cos = float(np.sin(np.radians(angle))), float(np.cos(np.radians(angle)))
        at = mi.Vector3f(0.8 * sin, 0.6 * sin, cos), mi.Point2f(0.3 + 0.17 * i, 0.61 - 0.2 * i)
        dr.make_opaque(at)
        yield f"wi {angle:.0f}°", partial(surface, *at)


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


class BSDF(Tests):
    """Tests of a BSDF."""

    SMOOTH = ("eval()",)

    def test_finite(self, bsdf: Any) -> None:
        """Values, densities and weights are finite and not negative, also at grazing angles and extreme numbers."""
        q, flag = Queries(bsdf, extreme=True), mi.BSDFFlags
        inside = bsdf.flags() & np.where(q.wi[2] > 0, int(flag.FrontSide), int(flag.BackSide)) != 0
        for name, values, least in (("eval()", q.value, 0), ("weight", q.weight, 0), ("pdf()", q.density, -np.inf)):
            self.report.finite(name, values, q.where, on=inside, least=least)
        self.report.unit("sampled directions", q.wo, q.where, on=q.valid)
        albedo = rows(bsdf.eval_diffuse_reflectance(q.si), INPUTS)
        right, on = np.abs(albedo - 0.5) < 0.501, bsdf.flags() & int(flag.Glossy) == 0
        self.report.require("eval_diffuse_reflectance() is from 0 to 1", right, {"uv": q.uv}, on=on)

    def test_weights(self, bsdf: Any) -> None:
        """weight = eval() / pdf(), and eval_pdf() and eval_pdf_sample() agree with eval(), pdf() and sample()."""
        importance, none, kinds = mi.BSDFContext(mi.TransportMode.Importance), mi.BSDFContext(), int(mi.BSDFFlags.All)
        none.type_mask = 0
        for name, ctx, flags in [*contexts(bsdf, mi.BSDFContext), ("importance, ", importance, bsdf.flags())]:
            q = Queries(bsdf, ctx)
            drawn, wo = mi.Vector3f(q.wo), mi.Vector3f(q.out)
            where, sampled = ({name.rstrip(", "): (), **one} for one in (q.where, q.sampled))
            values = [f(ctx, q.si, one) for one in (drawn, wo) for f in (bsdf.eval, bsdf.pdf)]
            dark = bsdf.eval(none, q.si, wo), bsdf.eval(ctx, q.si, wo, mi.Bool(False))
            dr.eval(values, dark)  # in one kernel
            self.samples(q.sent, q.pdf, values[0], values[1], sampled, on=q.smooth)
            right = q.has(kinds) & ~q.has(kinds & ~flags)
            self.report.require("sampled_type is a lobe of flags()", right, sampled, on=q.valid)
            value, pdf, bs, weight = found = bsdf.eval_pdf_sample(ctx, q.si, wo, q.u1, q.u2)
            dr.eval(found)
            for test, a, b in (
                ("eval_pdf() = eval(), pdf()", q.value, values[2]),
                ("eval_pdf() = eval(), pdf()", q.density, values[3]),
                ("eval_pdf_sample() = eval(), pdf()", value, q.value),
                ("eval_pdf_sample() = eval(), pdf()", pdf, q.density),
                ("eval_pdf_sample() = sample()", weight, q.weight),
                ("eval_pdf_sample() = sample()", bs.pdf, q.pdf),
                ("eval() is 0 if the context has no type", dark[0], 0),
                ("eval() is 0 in inactive lanes", dark[1], 0),
            ):
                # Mitsuba's integrators ask for all types, and Dr.Jit masks all results.
                harmless = test.startswith("eval() is 0") and isinstance(bsdf, OnCopies)
                self.report.equal(test, a, b, where, worst=NOTE if harmless else FAILS)

    everywhere = test_weights

    def test_lobes(self, bsdf: Any) -> None:
        """A sample goes where its type says, the types are those of the flags, and so is where the BSDF is not 0."""
        q, flag = Queries(bsdf), mi.BSDFFlags
        lobes = np.array([bsdf.flags(i) for i in range(bsdf.component_count())] or [0])
        union, kinds = int(np.bitwise_or.reduce(lobes)), int(flag.All)
        allowed, sided = np.zeros((2, INPUTS), dtype=bool)
        for one in lobes:
            side = np.where(q.wi[2] > 0, one & int(flag.FrontSide), one & int(flag.BackSide)) != 0
            lobe = np.where(q.wi[2] * q.out[2] > 0, one & int(flag.Reflection), one & int(flag.Transmission)) != 0
            allowed |= side & lobe & (one & int(flag.Smooth) != 0)
            sided |= side & q.has(one & kinds)
        for one in lobes & kinds:
            self.report.require("every lobe of the flags is sampled", [(q.has(one) & q.valid).any()], f"type {one:#x}")
        worst = NOTE if is_fibre(bsdf) else FAILS
        right = allowed | ~(q.value != 0).any(axis=0)
        self.report.require("eval() is 0 where the flags have no lobe", right, q.where, worst=worst)
        cos, reflects, passes = q.wi[2] * q.wo[2], q.has(flag.Reflection), q.has(flag.Transmission) | q.has(flag.Null)
        mirrored, sines = q.wi * [[-1], [-1], [1]], [np.linalg.norm(v[:2], axis=0) for v in (q.wi, q.wo)]
        snell = np.abs(sines[0] - q.eta * sines[1]) < 2e-3
        half, inclined = q.wi + q.eta * q.wo, np.minimum(np.abs(q.wi[2]), np.abs(q.wo[2])) > 0.05
        cosines = np.array([(half * v).sum(axis=0) * v[2] * half[2] for v in (q.wi, q.wo)])
        refracts = passes & ~reflects & inclined & (np.abs(q.eta[0] - 1) > 1e-3)
        for test, on, right, share in (
            ("flags() = those of all components", True, bsdf.flags() == union, 0),
            ("the flags have the side of a sample", not is_fibre(bsdf), sided, 0),
            ("sampled_component has the type", True, lobes[q.lobe % len(lobes)] & q.type != 0, 0),
            ("reflection stays on its side", reflects & ~passes, cos > -1e-4, 0),
            ("transmission leaves its side", passes & ~reflects, cos < 1e-4, 0),
            ("a null lobe goes straight on", q.has(flag.Null), np.abs(q.wo + q.wi) < 1e-3, 0),
            ("eta of reflection is 1", reflects, np.abs(q.eta - 1) < 1e-5, 0),
            ("ideal reflection mirrors wi", q.has(flag.DeltaReflection), np.abs(q.wo - mirrored) < 1e-3, 0),
            ("ideal refraction obeys Snell's law", q.has(flag.DeltaTransmission), snell, 0),
            ("a facet refracts wi to wo", refracts, cosines > -1e-4, 0.02),
        ):
            self.report.require(test, right, q.sampled, on=on & q.valid, share=share)
        other = Queries(bsdf, mi.BSDFContext(mi.TransportMode.Importance))
        same = passes & q.valid & other.valid & (np.abs(q.wo - other.wo).max(axis=0) < 1e-3)
        # Glass that disperses light has an index for each colour; if it is rough, several colours share a direction.
        front = q.wi[2] > 0
        least, most = (
            np.where(front, *(bound(q.eta[0], where=same & side, initial=start) for side in (front, ~front)))
            for bound, start in ((np.min, 1e9), (np.max, 1e-9))
        )
        nearest = np.clip(q.weight, other.weight / most**2, other.weight / least**2)
        self.report.equal("radiance = importance / eta²", q.weight, nearest, q.sampled, on=same)

    def draw(self, bsdf: Any, ctx: Any, si: Any, u: Any) -> tuple[Any, Any, Any]:
        """A sample; the density is 0 where the BSDF is black."""
        bs, weight = bsdf.sample(ctx, si, u[0], mi.Point2f(u[1], u[2]))
        smooth = (bs.sampled_type & int(mi.BSDFFlags.Delta)) == 0
        return bs.wo, weight, dr.select(smooth & lit(weight), bs.pdf, 0)

    def evaluate(self, bsdf: Any, ctx: Any, si: Any, wo: Any) -> tuple[Any, Any]:
        """The value, and the density where the BSDF is not black."""
        value, pdf = bsdf.eval_pdf(ctx, si, wo)
        return value, dr.select(lit(value), pdf, 0)

    def test_density(self, bsdf: Any) -> None:
        """Directions of sample() have the density of pdf()."""
        for name, ctx, flags in contexts(bsdf, mi.BSDFContext):
            for angle, at in incidences(bsdf) if flags & int(mi.BSDFFlags.Smooth) else ():
                self.density(name + angle, bsdf, ctx, at)

    def test_means(self, bsdf: Any) -> None:
        """Albedos are at most 1, the components have that of the whole, and ideal lobes have their probability."""
        delta, u = int(mi.BSDFFlags.Delta), uniform(SAMPLES, 3, 3)
        for angle, at in incidences(bsdf):
            found = []
            for _, ctx, _ in contexts(bsdf, mi.BSDFContext):
                ctx.mode = mi.TransportMode.Importance
                found.append(bsdf.sample(ctx, at(SAMPLES), mi.Float(u[0]), mi.Point2f(u[1:])))
            whole, _ = found[0]
            pdf, kind, weight, *parts = rows_of((whole.pdf, whole.sampled_type, *(w for _, w in found)), SAMPLES)
            brightest = weight[np.argmax(weight.mean(axis=1))]
            self.report.mean("albedo at most 1", brightest, 0, 1.002, angle)
            if parts:
                sums = np.sum(parts, axis=(0, 1)) / len(weight)
                self.report.same_mean("components add up to the whole", sums, weight.mean(axis=0), angle)
            ideal = (kind[0].astype(int) & delta != 0) & (pdf[0] > 0)
            for stated in np.unique(pdf[0, ideal].round(4)):
                share, where = ideal & (np.abs(pdf[0] - stated) < 1e-4), f"{angle}, pdf {stated:.4f}"
                self.report.mean("ideal lobes have their probability", share, stated - 1e-3, stated + 1e-3, where)

    def test_symmetry(self, bsdf: Any) -> None:
        """f(wi, wo) = f(wo, wi), where radiance one way is importance the other way."""
        q, tilted = Queries(bsdf), is_tilted(bsdf)
        back = bsdf.eval(mi.BSDFContext(mi.TransportMode.Importance), surface(q.out, q.uv), mi.Vector3f(q.wi))
        cosines = np.abs(q.wi[2]), np.abs(q.out[2])
        there, back, on = q.value / cosines[1], rows(back) / cosines[0], np.minimum(*cosines) > 0.02
        worst = NOTE if tilted or is_fibre(bsdf) else FAILS
        self.report.equal("reciprocity", there, back, q.where, (0.05, 0.02), on=on, worst=worst, share=0.01)
        if not tilted and not bsdf.flags() & int(mi.BSDFFlags.Anisotropic):
            test = "without the flag Anisotropic, a turn changes nothing"
            self.report.equal(test, turned(bsdf, q), q.value, q.where, (0.03, 1e-4))

    def test_indices(self, bsdf: Any) -> None:
        """Light that enters from the front meets the index int_ior / ext_ior, where these are parameters."""
        indices = {"int_ior": 1.9, "ext_ior": 1.2}
        glass = self.subject.changed(**indices, int_abbe=1000.0) or self.subject.changed(**indices)  # hardly disperses
        if glass is not None:
            q = Queries(glass)
            enters = q.valid & (q.wi[2] > 0) & (q.wo[2] < 0) & (q.eta[0] != 1)
            self.report.equal("eta from the front = int_ior / ext_ior", q.eta, 1.9 / 1.2, q.sampled, on=enters)

    def inputs(self, n: int) -> list[np.ndarray]:
        """Two directions, uv and uniform numbers; two of three pairs of directions are on one side."""
        u = 0.02 + 0.96 * uniform(n, 5, 71)
        wi, wo = directions(n, 72), directions(n, 73)
        wo[2] *= np.sign(wo[2] * wi[2]) * np.where(np.arange(n) % 3 == 0, -1, 1)
        return [wi, wo, u[:2], u[2:3], u[3:]]

    def values(self, bsdf: Any, wi: Any, wo: Any, uv: Any, u1: Any, u2: Any, wavelengths: Any) -> dict[str, Any]:
        """Values, densities and weights."""
        si, ctx = surface(wi, uv, None, wavelengths), mi.BSDFContext()
        value, pdf = bsdf.eval_pdf(ctx, si, wo)
        bs, weight = bsdf.sample(ctx, si, u1, u2)
        sent = dr.select(bs.pdf > 0, weight * bs.pdf, 0)
        return {"eval()": value, "pdf()": pdf, "weight times pdf of sample()": sent}


#: Directions of statistical tests.
INCIDENCES = (0.0, 0.0, 1.0), (0.48, -0.8, 0.36)


def crossing(medium: Any, u: Any) -> Any:
    """Interactions at sampled distances, of rays through the unit cube."""
    n = dr.width(u)
    ray = mi.Ray3f(mi.Point3f(uniform(n, 3, 1) * 0.2), dr.normalize(mi.Vector3f(uniform(n, 3, 2) + 0.1)))
    return medium.sample_interaction(ray, u, mi.UInt32(0), mi.Bool(True))


class Medium(Tests):
    """Tests of a medium."""

    def test_coefficients(self, medium: Any) -> None:
        """Coefficients are not negative; scattering is part of the extinction; null collisions fill the majorant."""
        mei = crossing(medium, mi.Float(uniform(INPUTS, 1, 3)[0]))
        found = rows(mei.is_valid(), INPUTS)[0].astype(bool)
        coefficients = *medium.get_scattering_coefficients(mei), medium.get_majorant(mei)
        scattering, null, extinction, majorant = rows_of(coefficients, INPUTS)
        least = np.minimum(np.minimum(scattering, null), extinction)
        self.report.require("coefficients are not negative", least >= -1e-4 * majorant, on=found)
        self.report.require("sigma_s is at most sigma_t", scattering <= extinction * 1.001 + 1e-6, on=found)
        self.report.equal("majorant = sigma_t + sigma_n", extinction + null, majorant, on=found)

    def test_distances(self, medium: Any) -> None:
        """Sampled distances are exponential with the majorant; transmittance_eval_pdf() is their density."""
        if not medium.is_homogeneous():
            return

        def sample(u: Any) -> Any:
            mei = crossing(medium, u[0])
            return 1 - dr.exp(-mei.t * mi.unpolarized_spectrum(medium.get_majorant(mei))[0])

        self.report.density("sampled distances are exponential", sample, lambda _: mi.Float(1), dimensions=1)
        mei = crossing(medium, mi.Float(uniform(INPUTS, 1, 3)[0]))
        far = interaction(mi.SurfaceInteraction3f, INPUTS, t=dr.full(mi.Float, dr.inf, INPUTS))
        through, pdf = medium.transmittance_eval_pdf(mei, far, mi.Bool(True))
        majorant = rows(medium.get_majorant(mei), INPUTS)
        expected = np.exp(-majorant * rows(mei.t, INPUTS))
        self.report.equal("transmittance is exponential", through, expected)
        self.report.equal("pdf of a distance = majorant times transmittance", pdf, expected * majorant)

    def inputs(self, n: int) -> list[np.ndarray]:
        """Places in the unit cube."""
        return [uniform(n, 3, 4)]

    def values(self, medium: Any, p: Any, wavelengths: Any) -> dict[str, Any]:
        """The coefficients."""
        mei = interaction(mi.MediumInteraction3f, dr.width(p), wavelengths, p=p, t=mi.Float(1))
        scattering, _, extinction = medium.get_scattering_coefficients(mei)
        return {"sigma_s": scattering, "sigma_t": extinction, "majorant": medium.get_majorant(mei)}


def seen(wi: Any, n: int | None = None, wavelengths: Any = None) -> Any:
    """Points of a medium that are seen from the directions ``wi``."""
    n = n or dr.width(wi)
    wi = mi.Vector3f(wi) + dr.zeros(mi.Vector3f, n)
    fields = {"wi": wi, "sh_frame": mi.Frame3f(wi), "p": mi.Point3f(0.3, 0.6, 0.4), "t": mi.Float(1)}
    return interaction(mi.MediumInteraction3f, n, wavelengths, **fields)


def angle(wi: np.ndarray, wo: np.ndarray) -> dict[str, np.ndarray]:
    """The angle between both directions of each input, in degrees."""
    return {"angle": np.degrees(np.arccos(np.clip((wi * wo).sum(axis=0), -1, 1)))}


class PhaseFunction(Tests):
    """Tests of a phase function."""

    SMOOTH = ("eval_pdf()",)

    def test_samples(self, phase: Any) -> None:
        """Weights, densities and directions of samples fit eval_pdf()."""
        u, wi = uniform(INPUTS, 3, 2), directions(INPUTS, 3)
        for _, ctx, _ in contexts(phase, mi.PhaseFunctionContext):
            wo, weight, pdf = self.draw(phase, ctx, seen(wi), mi.Vector3f(u))
            dr.eval(wo, weight, pdf)
            where = angle(wi, rows(wo, INPUTS))
            self.report.finite("weight", weight, where)
            self.report.unit("sampled directions", wo, where)
            self.samples(weight, pdf, *self.evaluate(phase, ctx, seen(wi), wo), where)

    everywhere = test_samples

    def draw(self, phase: Any, ctx: Any, mei: Any, u: Any) -> tuple[Any, Any, Any]:
        """A sample."""
        return phase.sample(ctx, mei, u[0], mi.Point2f(u[1], u[2]))

    def evaluate(self, phase: Any, ctx: Any, mei: Any, wo: Any) -> tuple[Any, Any]:
        """The value and the density."""
        return phase.eval_pdf(ctx, mei, wo)

    def test_density(self, phase: Any) -> None:
        """Directions of sample() have the density of eval_pdf(), which integrates to 1."""
        u = mi.Vector3f(uniform(SAMPLES, 3, 5))
        for direction in INCIDENCES:
            wi = mi.Vector3f(*direction)
            dr.make_opaque(wi)
            for name, ctx, _ in contexts(phase, mi.PhaseFunctionContext):
                self.density(f"{name}wi {direction}", phase, ctx, partial(seen, wi))
            weight = rows(self.draw(phase, mi.PhaseFunctionContext(), seen(wi, SAMPLES), u)[1], SAMPLES)[0]
            self.report.mean("the integral is 1", weight, 0.997, 1.003, f"wi {direction}")

    def test_symmetry(self, phase: Any) -> None:
        """Light takes each path both ways; without the flag of anisotropy, only the angle matters."""
        ctx, flag = mi.PhaseFunctionContext(), mi.PhaseFunctionFlags
        wi, wo = directions(INPUTS, 6), directions(INPUTS, 7)
        turn = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0], [0.48, 0.64, 0.6]], dtype=np.float32)
        pairs = (wi, wo), (wo, wi), (turn @ wi, turn @ wo)
        there, back, turned = rows_of(phase.eval_pdf(ctx, seen(a), mi.Vector3f(b))[0] for a, b in pairs)
        if phase.flags() & int(flag.Microflake):
            there, back = (v * rows(phase.projected_area(seen(one))) for v, one in ((there, wi), (back, wo)))
            right = rows(phase.projected_area(seen(wi))) <= rows(phase.max_projected_area()).max() * 1.001
            self.report.require("projected_area() is at most max_projected_area()", right)
        self.report.equal("reciprocity", there, back, angle(wi, wo), (0.03, 1e-4))
        if not phase.flags() & int(flag.Anisotropic | flag.Microflake):
            self.report.equal("without the flag Anisotropic, a turn changes nothing", turned, there, angle(wi, wo))

    def inputs(self, n: int) -> list[np.ndarray]:
        """Two directions, and uniform numbers."""
        u = 0.02 + 0.96 * uniform(n, 3, 8)
        return [directions(n, 9), directions(n, 10), u[:1], u[1:]]

    def values(self, phase: Any, wi: Any, wo: Any, u1: Any, u2: Any, wavelengths: Any) -> dict[str, Any]:
        """Value and density, and the weight of a sample."""
        mei, ctx = seen(wi, None, wavelengths), mi.PhaseFunctionContext()
        value, pdf = phase.eval_pdf(ctx, mei, wo)
        _, weight, _ = phase.sample(ctx, mei, u1, u2)
        return {"eval_pdf()": value, "pdf of eval_pdf()": pdf, "weight of sample()": weight}
