"""Tests of an emitter."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..inputs import directions, interaction, lit, place, rows, uniform
from ..report import NOTE, SKIPPED, Report
from ..statistics import chi_squared, welch
from ..subject import Subject

#: Number of inputs without statistics, and of samples with them.
INPUTS, SAMPLES = 2**13, 2**18

#: Emitters return light, not reflectances; values whose derivatives are tested.
LIGHT, SMOOTH = (True,), ("eval()", "light by sample_direction()")

#: Shapes that carry an emitter, and their scales; Mitsuba's sphere (3.9) has wrong normals if it is turned.
SHAPES = {"rectangle": [1, 0.6, 0.8], "sphere": [0.7] * 3, "cylinder": [0.6, 0.6, 1], "disk": [1, 0.6, 1], "cube": 0.6}


@dataclass
class Lamp:
    """An emitter in a scene. ``name`` is its shape; light leaves or reaches the sphere ``centre``, ``radius``."""

    name: str
    scene: Any
    emitter: Any
    centre: np.ndarray
    radius: float

    def has(self, flag: Any) -> bool:
        """Whether the emitter has the flag."""
        return bool(self.emitter.flags() & int(flag))

    @property
    def ideal(self) -> bool:
        """The flag Delta."""
        return self.has(mi.EmitterFlags.Delta)

    @property
    def infinite(self) -> bool:
        """The flag Infinite."""
        return self.has(mi.EmitterFlags.Infinite)


def prepare(emitter: Any, shape: str = "rectangle") -> Lamp:
    """Puts an emitter into a scene, on a shape if it needs one."""
    surface, infinite = (
        bool(emitter.flags() & int(flag)) for flag in (mi.EmitterFlags.Surface, mi.EmitterFlags.Infinite)
    )
    turn = mi.ScalarTransform4f().translate([0.1, 0.2, -0.1]).rotate([0.6, 0, 0.8], 0 if shape == "sphere" else 40)
    carrier = {"type": shape, "to_world": turn.scale(SHAPES[shape]), "emitter": emitter}
    target = {"target": {"type": "sphere"}} if infinite else {}
    scene = mi.load_dict({"type": "scene", "lamp": carrier if surface else emitter, **target})
    lamp = Lamp(shape if surface else "", scene, (scene.emitters() or [scene.environment()])[0], np.zeros(3), 0.5)
    if not infinite:
        box = scene.bbox() if surface else lamp.emitter.bbox()
        low, high = (np.nan_to_num(np.array(v, dtype=float), posinf=0, neginf=0) for v in (box.min, box.max))
        lamp.centre, lamp.radius = (low + high) / 2, max(0.5, 0.6 * float(np.linalg.norm(high - low)))
    return lamp


def motion(emitter: Any) -> np.ndarray:
    """The matrix that moves the emitter in tests: a rotation, and a translation if it is not infinite."""
    turn = mi.ScalarTransform4f().rotate([0.48, 0.8, 0.36], 70)
    infinite = emitter.flags() & int(mi.EmitterFlags.Infinite)
    return np.array((turn if infinite else mi.ScalarTransform4f().translate([0.4, -0.2, 0.3]) @ turn).matrix)


def moved(subject: Subject) -> Lamp | None:
    """The emitter after a motion; None if it has no to_world."""
    before = subject.props["to_world"] if "to_world" in subject.props else mi.ScalarTransform4f()
    try:
        lamp = prepare(subject.load(to_world=type(before)(motion(subject.load()) @ np.array(before.matrix))))
    except (RuntimeError, TypeError):
        return None
    lamp.name = "moved"
    return lamp


def lamps(subject: Subject) -> Iterator[Lamp]:
    """Yields the emitter in each scene in which it is tested: on each shape, or as it is and moved."""
    first = prepare(subject.load())
    yield first
    if first.has(mi.EmitterFlags.Surface):
        yield from (prepare(subject.load(), shape) for shape in list(SHAPES)[1:])
    elif (other := moved(subject)) is not None:
        yield other


def point(p: Any, n: int | None = None) -> Any:
    """Receivers at ``p``."""
    n = n or dr.width(p)
    return interaction(mi.Interaction3f, n, p=p + dr.zeros(mi.Point3f, n))


def receivers(lamp: Lamp, n: int, seed: int) -> Any:
    """Points that receive light: around a finite emitter, or within an infinite one."""
    u = uniform(n, 1, seed + 2000)
    p = lamp.centre[:, None] + directions(n, seed + 1) * lamp.radius * (2 * u if lamp.infinite else 1 + 3 * u)
    return mi.Point3f(p.astype(np.float32))


def aimed(lamp: Lamp, it: Any, n: int, seed: int) -> tuple[Any, np.ndarray, np.ndarray]:
    """Sampled directions: the sample, its direction (3, n) and its weight (channels, n)."""
    ds, weight = lamp.emitter.sample_direction(it, mi.Point2f(uniform(n, 2, seed)))
    return ds, rows(ds.d, n), rows(weight, n)


def seen(lamp: Lamp, it: Any, d: Any) -> tuple[Any, Any, Any]:
    """What is seen from ``it`` in the direction ``d``: interaction, whether the emitter is there, sample."""
    if lamp.infinite:
        si = interaction(mi.SurfaceInteraction3f, dr.width(d), wi=-d, t=mi.Float(dr.inf))
        hit = dr.full(mi.Bool, True, dr.width(d))
    else:
        si = lamp.scene.ray_intersect(mi.Ray3f(it.p, d, 0, it.wavelengths))
        hit = si.is_valid()
    ds = mi.DirectionSample3f(lamp.scene, si, it)
    ds.d = d
    return si, hit, ds


def octants(report: Report, test: str, lamp: Lamp, *terms: tuple[np.ndarray, np.ndarray]) -> None:
    """Compares two samples of light, each the light (channels, n) and where it is (3, n), in each octant."""
    for side in range(8):
        a, b = (v.mean(axis=0) * (((p > 0) * [[1], [2], [4]]).sum(axis=0) == side) for v, p in terms)
        report.add(test, where=f"{lamp.name} octant {side}".strip(), **welch(a, b))


def test_directions(subject: Subject, report: Report) -> None:
    """Weight, density and value of sampled directions fit together."""
    for lamp in lamps(subject):
        it = point(receivers(lamp, INPUTS, 2))
        ds, d, weight = aimed(lamp, it, INPUTS, 4)
        pdf, found = rows(ds.pdf, INPUTS), (weight > 0).any(axis=0)
        where = place(f"{lamp.name} from", it.p)
        report.finite("weight", weight, where, on=pdf[0] > 0, least=-0.05 * np.nanmax(weight))  # a fit may be below 0
        report.unit("sampled directions", d, where, on=found)
        report.require("ds.delta is the flag", rows(ds.delta, INPUTS) == lamp.ideal, where, on=found)
        try:
            value = lamp.emitter.eval_direction(it, ds)
            report.equal("weight = eval_direction() / pdf", weight * (1 if lamp.ideal else pdf), value, where, on=found)
        except RuntimeError as error:
            report.add("weight = eval_direction() / pdf", SKIPPED, str(error).splitlines()[-1])
        stated = lamp.emitter.pdf_direction(it, ds)
        report.equal("pdf of a sample = pdf_direction()", 0 if lamp.ideal else pdf, stated, where, on=found)
        if not lamp.ideal:
            si, hit, _ = seen(lamp, it, ds.d)
            distance, met = rows(ds.dist, INPUTS)[0], rows(si.t, INPUTS)[0]
            near = lamp.infinite | (np.abs(met - distance) < 1e-2 * distance)
            on = found & rows(hit)[0].astype(bool) & near
            report.equal("weight = eval() / pdf", weight * pdf, lamp.emitter.eval(si), where, on=on)
            report.require("sampled points are on the shape", near | (met < distance), where, on=found, share=0.01)


def test_density(subject: Subject, report: Report) -> None:
    """Directions of sample_direction() have the density of pdf_direction(), from two places."""
    for lamp in lamps(subject):
        for receiver in rows(receivers(lamp, 2, 11)).T if not lamp.ideal else ():
            p = mi.Point3f(*map(float, receiver))
            dr.make_opaque(p)

            def sample(u: Any, lamp: Lamp = lamp, p: Any = p) -> tuple[Any, Any]:
                ds, weight = lamp.emitter.sample_direction(point(p, dr.width(u)), u)
                return ds.d, (ds.pdf > 0) & lit(weight)

            def pdf(d: Any, lamp: Lamp = lamp, p: Any = p) -> Any:
                it = point(p, dr.width(d))
                si, hit, ds = seen(lamp, it, d)
                bright = hit & lit(lamp.emitter.eval(si, hit))
                return dr.select(bright, lamp.emitter.pdf_direction(it, ds, hit), 0)

            where = f"{lamp.name} from {receiver.round(2)}"
            chi_squared(report, "samples follow pdf_direction()", where, sample, pdf, dimensions=2)


def test_light(subject: Subject, report: Report) -> None:
    """Receivers get the same light by sampling the emitter as by rays, half of which go to everywhere."""
    for lamp in lamps(subject):
        if lamp.ideal:
            return
        p = receivers(lamp, SAMPLES, 21)
        it = point(p)
        _, _, weight = aimed(lamp, it, SAMPLES, 22)
        ds, _, aim = aimed(lamp, it, SAMPLES, 24)
        everywhere = mi.Bool(uniform(SAMPLES, 1, 25)[0] < 0.5)
        d = dr.select(everywhere, mi.warp.square_to_uniform_sphere(mi.Point2f(uniform(SAMPLES, 2, 23))), ds.d)
        si, hit, ds = seen(lamp, it, d)
        hit &= everywhere | mi.Bool((aim > 0).any(axis=0))  # samples on the dark side of a lamp do not count
        density = 0.5 / (4 * np.pi) + 0.5 * dr.select(hit, lamp.emitter.pdf_direction(it, ds, hit), 0)
        value, from_centre = dr.select(hit, lamp.emitter.eval(si, hit), 0) / density, rows(p) - lamp.centre[:, None]
        octants(
            report,
            "light by sampling = light by rays",
            lamp,
            (weight, from_centre),
            (rows(value, SAMPLES), from_centre),
        )


def test_flux(subject: Subject, report: Report) -> None:
    """The light that sample_ray() sends through a sphere is the light that sample_direction() finds on it."""
    for lamp in lamps(subject):
        if lamp.name in SHAPES and lamp.ideal:
            return  # no receiver finds it by sampling
        u = uniform(SAMPLES, 5, 31)
        ray, sent = lamp.emitter.sample_ray(0.0, mi.Float(u[0]), mi.Point2f(u[1:3]), mi.Point2f(u[3:]))
        o, d = rows(ray.o, SAMPLES) - lamp.centre[:, None], rows(ray.d, SAMPLES)
        along = (o * d).sum(axis=0)
        root = along**2 - (o * o).sum(axis=0) + lamp.radius**2
        t = -along + (-1 if lamp.infinite else 1) * np.sqrt(np.maximum(root, 0))
        sent = np.where((root > 0) & (t > 0), rows(sent, SAMPLES), 0)
        n = rows(mi.warp.square_to_uniform_sphere(mi.Point2f(uniform(SAMPLES, 2, 32))))
        p = mi.Point3f((lamp.centre[:, None] + lamp.radius * n).astype(np.float32))
        _, to_light, weight = aimed(lamp, point(p), SAMPLES, 33)
        cos = (to_light * n).sum(axis=0) * (1 if lamp.infinite else -1)
        got = weight * np.maximum(cos, 0) * 4 * np.pi * lamp.radius**2
        octants(report, "flux of sample_ray() = flux by directions", lamp, (sent, o + t * d), (got, n))


def test_positions(subject: Subject, report: Report) -> None:
    """Sampled positions have the density of pdf_position(), and its reciprocal as weight."""
    for lamp in lamps(subject):
        if not lamp.infinite:
            ps, weight = lamp.emitter.sample_position(0.0, mi.Point2f(uniform(INPUTS, 2, 41)))
            stated, there = lamp.emitter.pdf_position(ps), rows(ps.pdf, INPUTS) > 0
            report.equal("weight of a position = 1 / pdf", rows(weight) * rows(ps.pdf), there, lamp.name)
            report.equal("pdf of a position = pdf_position()", ps.pdf, stated, lamp.name)


def test_motion(subject: Subject, report: Report) -> None:
    """is_environment() is the flag; with another to_world, the emitter's light moves along."""
    lamp, n = prepare(subject.load()), 2**15
    if not lamp.has(mi.EmitterFlags.DeltaDirection):
        report.require("is_environment() is the flag Infinite", [lamp.emitter.is_environment() == lamp.infinite])
    if lamp.name in SHAPES or (other := moved(subject)) is None:
        return
    p, matrix = receivers(lamp, n, 51), motion(lamp.emitter)
    q = point(mi.Point3f((matrix[:3, :3] @ rows(p) + matrix[:3, 3:]).astype(np.float32)))
    (_, d, before), (_, moved_d, after), (_, still_d, still) = (
        aimed(one, it, n, 52) for one, it in ((lamp, point(p)), (other, q), (lamp, q))
    )
    if np.allclose(after, still, rtol=1e-3) and np.allclose(moved_d, still_d, atol=1e-3):
        report.add("to_world moves the light", NOTE, "to_world has no effect")
    else:
        octants(report, "to_world moves the light", lamp, (before, matrix[:3, :3] @ d), (after, moved_d))


def inputs(n: int) -> list[np.ndarray]:
    """Places of receivers, and uniform numbers."""
    u = uniform(n, 6, 61)
    return [directions(n, 62) * (1 + u[:1]), u[1:3], u[3:4], u[4:]]


def values(lamp: Any, p: Any, u: Any, u1: Any, u3: Any, wavelengths: Any) -> dict[str, Any]:
    """The light at given places, in given directions, and in sampled ones."""
    far = mi.Float(dr.inf if lamp.infinite else 1)
    it = interaction(mi.Interaction3f, dr.width(p), wavelengths, p=p * (0.4 if lamp.infinite else 2.0))
    ds, weight = lamp.emitter.sample_direction(it, u)
    if lamp.ideal:
        return {"light by sample_direction()": weight}
    si = interaction(mi.SurfaceInteraction3f, dr.width(p), wavelengths, wi=dr.normalize(p), uv=u, t=far)
    found = {"eval()": lamp.emitter.eval(si)}
    if "rgb" not in mi.variant():
        return found  # the sampled directions depend on the luminance of colours
    _, sent = lamp.emitter.sample_ray(0.0, u1, u, u3)
    return found | {"weight of sample_ray()": sent, "light by sample_direction()": weight * ds.pdf}


TESTS = test_directions, test_density, test_light, test_flux, test_positions, test_motion
