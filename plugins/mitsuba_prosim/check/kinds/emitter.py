"""Tests of an emitter."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..report import NOTE, SKIPPED, Report
from ..statistics import chi_squared, directions, rows, uniform_inputs, welch
from ..subject import Subject

#: Number of inputs without statistics, and of samples with them.
INPUTS, SAMPLES = 2**13, 2**18

#: Emitters return light, not reflectances; values whose derivatives are tested.
EMITS, SMOOTH = True, ("eval()", "light by sample_direction()")

#: Shapes that carry an emitter.
SHAPES = ("rectangle", "sphere", "cylinder", "disk", "cube")


@dataclass
class Lit:
    """An emitter in a scene. ``name`` is its shape; light leaves or reaches the sphere ``centre``, ``radius``."""

    name: str
    scene: Any
    emitter: Any
    infinite: bool
    centre: np.ndarray
    radius: float

    @property
    def ideal(self) -> int:
        """The flag Delta."""
        return int(self.emitter.flags() & int(mi.EmitterFlags.Delta))


def place(emitter: Any, shape: str = "rectangle") -> Lit:
    """Puts an emitter into a scene, on a shape if it needs one."""
    infinite = bool(emitter.flags() & int(mi.EmitterFlags.Infinite))
    scene: dict[str, Any] = {"type": "scene"}
    if is_surface(emitter):
        turn = mi.ScalarTransform4f().translate([0.1, 0.2, -0.1])
        if shape != "sphere":  # the normals of Mitsuba's sphere (3.9) are wrong if it is turned
            turn = turn.rotate([0.6, 0, 0.8], 40)
        scale = 0.7 if shape == "sphere" else [0.6, 0.6, 1] if shape == "cylinder" else [1, 0.6, 0.8]
        scene = scene | {"shape": {"type": shape, "to_world": turn.scale(scale), "emitter": emitter}}
    else:
        shape, scene = "", scene | {"emitter": emitter} | ({"target": {"type": "sphere"}} if infinite else {})
    loaded = mi.load_dict(scene)
    lamp = loaded.emitters()[0] if loaded.emitters() else loaded.environment()
    if infinite:
        return Lit(shape, loaded, lamp, True, np.zeros(3), 0.5)
    box = loaded.bbox() if is_surface(lamp) else lamp.bbox()
    low, high = (np.nan_to_num(np.array(v, dtype=float), posinf=0, neginf=0) for v in (box.min, box.max))
    return Lit(shape, loaded, lamp, False, (low + high) / 2, max(0.5, 0.6 * float(np.linalg.norm(high - low))))


def is_surface(emitter: Any) -> bool:
    """Whether the emitter needs a shape."""
    return bool(emitter.flags() & int(mi.EmitterFlags.Surface))


def motion(emitter: Any) -> np.ndarray:
    """The matrix that moves the emitter in tests: a rotation, and a translation if it is not infinite."""
    turn = mi.ScalarTransform4f().rotate([0.48, 0.8, 0.36], 70)
    infinite = emitter.flags() & int(mi.EmitterFlags.Infinite)
    return np.array((turn if infinite else mi.ScalarTransform4f().translate([0.4, -0.2, 0.3]) @ turn).matrix)


def place_moved(subject: Subject) -> Lit | None:
    """The emitter after a motion; None if it has no to_world."""
    before = subject.props["to_world"] if "to_world" in subject.props else mi.ScalarTransform4f()
    try:
        lit = place(subject.load(to_world=type(before)(motion(subject.load()) @ np.array(before.matrix))))
    except (RuntimeError, TypeError):
        return None
    lit.name = "moved"
    return lit


def lamps(subject: Subject) -> Iterator[Lit]:
    """Yields the emitter in each scene in which it is tested: on each shape, or as it is and moved."""
    if is_surface(subject.load()):
        yield from (place(subject.load(), shape) for shape in SHAPES)
        return
    yield place(subject.load())
    if (moved := place_moved(subject)) is not None:
        yield moved


def point(p: Any) -> Any:
    """A receiver at ``p``."""
    it = dr.zeros(mi.Interaction3f, dr.width(p)) if dr.is_jit_v(mi.Float) else dr.zeros(mi.Interaction3f)
    it.p = mi.Point3f(p)
    if mi.is_spectral:
        it.wavelengths = mi.UnpolarizedSpectrum(450, 520, 590, 650)
    return it


def receivers(lit: Lit, n: int, seed: int) -> np.ndarray:
    """Points that receive light, shape (3, n): around a finite emitter, or within an infinite one."""
    u = uniform_inputs(n, 1, seed + 2000)
    return (lit.centre[:, None] + directions(n, seed + 1) * lit.radius * (2 * u if lit.infinite else 1 + 3 * u)).astype(
        np.float32
    )


def sphere(n: int, seed: int) -> np.ndarray:
    """Uniform directions, shape (3, n)."""
    return np.array(mi.warp.square_to_uniform_sphere(mi.Point2f(uniform_inputs(n, 2, seed))))


def aimed(lit: Lit, it: Any, n: int, seed: int) -> tuple[Any, np.ndarray, np.ndarray]:
    """Sampled directions: the sample, its direction (3, n) and its weight (channels, n)."""
    ds, weight = lit.emitter.sample_direction(it, mi.Point2f(uniform_inputs(n, 2, seed)))
    return ds, rows(ds.d, n), rows(weight, n)


def seen(lit: Lit, it: Any, d: Any) -> tuple[Any, Any, Any]:
    """What is seen from ``it`` in the direction ``d``: interaction, whether the emitter is there, sample."""
    if lit.infinite:
        si, hit = dr.zeros(mi.SurfaceInteraction3f, dr.width(d)), dr.full(mi.Bool, True, dr.width(d))
        si.wi, si.t, si.wavelengths = -d, mi.Float(dr.inf), it.wavelengths
    else:
        si = lit.scene.ray_intersect(mi.Ray3f(it.p, d, 0, it.wavelengths))
        hit = si.is_valid()
    ds = mi.DirectionSample3f(lit.scene, si, it)
    ds.d = d
    return si, hit, ds


def octants(report: Report, test: str, lit: Lit, *terms: tuple[np.ndarray, np.ndarray]) -> None:
    """Compares two samples of light, each the light (n) and where it is (3, n), in each octant, by Welch's test."""
    for side in range(8):
        a, b = (v * (((p > 0) * [[1], [2], [4]]).sum(axis=0) == side) for v, p in terms)
        report.add(test, where=f"{lit.name} octant {side}".strip(), **welch(a, b))


def _text(p: np.ndarray) -> str:
    return f"({', '.join(f'{x:.2f}' for x in p)})"


def test_directions(subject: Subject, report: Report) -> None:
    """Weight, density and value of sampled directions fit together."""
    for lit in lamps(subject):
        p = receivers(lit, INPUTS, 2)
        it = point(p)
        ds, d, weight = aimed(lit, it, INPUTS, 4)
        pdf, delta, found = rows(ds.pdf, INPUTS), rows(ds.delta, INPUTS), (weight > 0).any(axis=0)
        where = lambda i, p=p, lit=lit: f"{lit.name} from {_text(p[:, i])}"  # noqa: E731
        least = -0.05 * np.nanmax(np.where(np.isfinite(weight), weight, 0))  # fits of a sky may be slightly negative
        right = np.isfinite(weight) & (weight >= least) & np.isfinite(pdf) & (pdf >= 0) | (pdf == 0)
        report.require("weights and densities are finite, not negative", right, where=where)
        report.require(
            "sampled directions are unit vectors", np.abs(np.linalg.norm(d, axis=0) - 1) < 1e-3, where=where, on=found
        )
        report.require("ds.delta is the flag", delta == bool(lit.ideal), where=where, on=found)
        try:
            value = rows(lit.emitter.eval_direction(it, ds), INPUTS)
            report.equal("weight = eval_direction() / pdf", weight * (1 if lit.ideal else pdf), value, where, on=found)
        except RuntimeError as error:
            report.add("weight = eval_direction() / pdf", SKIPPED, str(error).splitlines()[-1])
        stated = rows(lit.emitter.pdf_direction(it, ds), INPUTS)
        if lit.ideal:
            report.require("pdf_direction() of an ideal emitter is 0", stated == 0, where=where)
            continue
        report.equal("pdf of a sample = pdf_direction()", pdf, stated, where, on=found)
        si, hit, _ = seen(lit, it, ds.d)
        distance, met = rows(ds.dist, INPUTS)[0], rows(si.t, INPUTS)[0]
        near = np.abs(met - distance) < 1e-2 * distance if not lit.infinite else found
        on = found & rows(hit, INPUTS)[0].astype(bool) & near
        report.equal("weight = eval() / pdf", weight * pdf, rows(lit.emitter.eval(si), INPUTS), where, on=on)
        report.require(
            "sampled points are on the shape", near | (met < distance), "no ray meets them", where, on=found, share=0.01
        )


def test_density(subject: Subject, report: Report) -> None:
    """Directions of sample_direction() have the density of pdf_direction(), from two places."""
    for lit in lamps(subject):
        for p_ in receivers(lit, 2, 11).T if not lit.ideal else ():
            p = mi.Point3f(*map(float, p_))
            dr.make_opaque(p)

            def sample(u: Any, lit: Lit = lit, p: Any = p) -> tuple[Any, Any]:
                ds, weight = lit.emitter.sample_direction(point(p + dr.zeros(mi.Point3f, dr.width(u))), u)
                valid = (ds.pdf > 0) & dr.any(mi.unpolarized_spectrum(weight) > 0)
                return dr.select(valid, ds.d, mi.Vector3f(0, 0, 1)), dr.select(valid, mi.Float(1), 0)

            def pdf(d: Any, lit: Lit = lit, p: Any = p) -> Any:
                it = point(p + dr.zeros(mi.Point3f, dr.width(d)))
                si, hit, ds = seen(lit, it, d)
                bright = hit & dr.any(mi.unpolarized_spectrum(lit.emitter.eval(si, hit)) > 0)
                return dr.select(bright, lit.emitter.pdf_direction(it, ds, hit), 0) + dr.zeros(mi.Float, dr.width(d))

            where = f"{lit.name} from {_text(p_)}"
            chi_squared(report, "samples follow pdf_direction()", where, sample, pdf, dimensions=2)


def test_light(subject: Subject, report: Report) -> None:
    """Receivers get the same light by sampling the emitter as by rays, half of which go to everywhere."""
    for lit in lamps(subject):
        if lit.ideal:
            return
        p = receivers(lit, SAMPLES, 21)
        it = point(p)
        _, _, weight = aimed(lit, it, SAMPLES, 22)
        ds, _, aim = aimed(lit, it, SAMPLES, 24)
        uniform = mi.Bool(uniform_inputs(SAMPLES, 1, 25)[0] < 0.5)
        si, hit, ds = seen(lit, it, dr.select(uniform, mi.Vector3f(sphere(SAMPLES, 23)), ds.d))
        hit &= uniform | mi.Bool((aim > 0).any(axis=0))  # samples on the dark side of a lamp do not count
        density = 0.5 / (4 * np.pi) + 0.5 * dr.select(hit, lit.emitter.pdf_direction(it, ds, hit), 0)
        value = rows(dr.select(hit, lit.emitter.eval(si, hit), 0) / density, SAMPLES)
        place_ = p - lit.centre[:, None]
        octants(
            report,
            "light by sampling = light by rays",
            lit,
            (weight.mean(axis=0), place_),
            (value.mean(axis=0), place_),
        )


def test_flux(subject: Subject, report: Report) -> None:
    """The light that sample_ray() sends through a sphere is the light that sample_direction() finds on it."""
    for lit in lamps(subject):
        if is_surface(lit.emitter) and lit.ideal:
            return  # no receiver finds it by sampling
        u = uniform_inputs(SAMPLES, 5, 31)
        ray, weight = lit.emitter.sample_ray(0.0, mi.Float(u[0]), mi.Point2f(u[1:3]), mi.Point2f(u[3:]))
        o, d = rows(ray.o, SAMPLES) - lit.centre[:, None], rows(ray.d, SAMPLES)
        along = (o * d).sum(axis=0)
        root = along**2 - (o * o).sum(axis=0) + lit.radius**2
        t = -along + (-1 if lit.infinite else 1) * np.sqrt(np.maximum(root, 0))
        sent = np.where((root > 0) & (t > 0), rows(weight, SAMPLES).mean(axis=0), 0)
        n = sphere(SAMPLES, 32)
        _, to_light, weight = aimed(lit, point((lit.centre[:, None] + lit.radius * n).astype(np.float32)), SAMPLES, 33)
        cos = (to_light * n).sum(axis=0) * (1 if lit.infinite else -1)
        got = weight.mean(axis=0) * np.maximum(cos, 0) * 4 * np.pi * lit.radius**2
        octants(report, "flux of sample_ray() = flux by directions", lit, (sent, o + t * d), (got, n))


def test_positions(subject: Subject, report: Report) -> None:
    """Sampled positions have the density of pdf_position(), and its reciprocal as weight."""
    for lit in lamps(subject):
        if lit.infinite:
            return
        ps, weight = lit.emitter.sample_position(0.0, mi.Point2f(uniform_inputs(INPUTS, 2, 41)))
        pdf = rows(ps.pdf, INPUTS)
        report.equal("weight of a position = 1 / pdf", rows(weight, INPUTS) * pdf, pdf > 0, lit.name)
        report.equal("pdf of a position = pdf_position()", pdf, rows(lit.emitter.pdf_position(ps), INPUTS), lit.name)


def test_motion(subject: Subject, report: Report) -> None:
    """is_environment() is the flag; with another to_world, the emitter's light moves along."""
    emitter, n = subject.load(), 2**15
    infinite = bool(emitter.flags() & int(mi.EmitterFlags.Infinite))
    if not emitter.flags() & int(mi.EmitterFlags.DeltaDirection):
        report.require("is_environment() is the flag Infinite", [emitter.is_environment() == infinite])
    if is_surface(emitter) or (other := place_moved(subject)) is None:
        return
    lit, matrix = place(emitter), motion(emitter)
    p = receivers(lit, n, 51)
    q = point((matrix[:3, :3] @ p + matrix[:3, 3:]).astype(np.float32))
    (_, d, weight), (_, moved_d, moved), (_, still_d, still) = (
        aimed(lamp, it, n, 52) for lamp, it in ((lit, point(p)), (other, q), (lit, q))
    )
    if np.allclose(moved, still, rtol=1e-3) and np.allclose(moved_d, still_d, atol=1e-3):
        report.add("to_world moves the light", NOTE, "to_world has no effect")
    else:
        light = (weight.mean(axis=0), matrix[:3, :3] @ d), (moved.mean(axis=0), moved_d)
        octants(report, "to_world moves the light", lit, *light)


prepare = place


def inputs(n: int) -> list[np.ndarray]:
    """Places of receivers, and uniform numbers."""
    u = uniform_inputs(n, 6, 61)
    return [directions(n, 62) * (1 + u[:1]), u[1:3], u[3:4], u[4:]]


def values(lit: Any, p: Any, u: Any, u1: Any, u3: Any, wavelengths: Any) -> dict[str, Any]:
    """The light at given places, in given directions, and in sampled ones."""
    it = point(p * (0.4 if lit.infinite else 2.0))
    it.wavelengths = wavelengths if mi.is_spectral else it.wavelengths
    ds, weight = lit.emitter.sample_direction(it, u)
    if lit.ideal:
        return {"light by sample_direction()": weight}
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(p)) if dr.is_jit_v(mi.Float) else dr.zeros(mi.SurfaceInteraction3f)
    si.wi, si.uv, si.wavelengths, si.t = dr.normalize(p), u, it.wavelengths, mi.Float(dr.inf if lit.infinite else 1)
    found = {"eval()": lit.emitter.eval(si)}
    if "rgb" not in mi.variant():
        return found  # the sampled directions depend on the luminance of colours
    _, sent = lit.emitter.sample_ray(0.0, u1, u, u3)
    return found | {"weight of sample_ray()": sent, "light by sample_direction()": weight * ds.pdf}


TESTS = test_directions, test_density, test_light, test_flux, test_positions, test_motion
