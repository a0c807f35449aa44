"""Tests of an emitter."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..report import NOTE, Report
from ..statistics import chi_squared, directions, spectrum, uniform_inputs, welch
from ..subject import Subject

#: Number of inputs without statistics, and of samples with them.
INPUTS, SAMPLES = 2**13, 2**18

#: Emitters return light, not reflectances; values whose derivatives are tested.
EMITS, SMOOTH = True, ("eval()", "light by sample_direction()")


@dataclass
class Lit:
    """An emitter in a scene. ``name`` is its shape; light leaves or reaches the sphere ``centre``, ``radius``."""

    name: str
    scene: Any
    emitter: Any
    infinite: bool
    centre: np.ndarray
    radius: float


def is_surface(emitter: Any) -> bool:
    """Whether the emitter needs a shape."""
    return bool(emitter.flags() & int(mi.EmitterFlags.Surface))


def shapes() -> dict[str, dict[str, Any]]:
    """Shapes that carry an emitter: name -> dictionary."""
    transform = mi.ScalarTransform4f
    turned = transform().rotate([0.6, 0, 0.8], 40).scale([1.0, 0.6, 0.8])
    tube = transform().translate([0.2, 0, 0]).rotate([1, 0, 0], 50)
    return {
        "rectangle": {"type": "rectangle", "to_world": turned},
        "sphere": {"type": "sphere", "radius": 0.7, "center": [0.1, 0.2, -0.1]},
        "cylinder": {"type": "cylinder", "radius": 0.4, "to_world": tube},
        "disk": {"type": "disk", "to_world": turned, "flip_normals": True},
        "cube": {"type": "cube", "to_world": transform().scale(0.5).rotate([0, 1, 0], 30)},
    }


def place(emitter: Any, shape: str = "rectangle") -> Lit:
    """Puts an emitter into a scene."""
    infinite = bool(emitter.flags() & int(mi.EmitterFlags.Infinite))
    if is_surface(emitter):
        scene = mi.load_dict({"type": "scene", "shape": shapes()[shape] | {"emitter": emitter}})
    else:
        target = {"target": {"type": "sphere"}} if infinite else {}
        scene = mi.load_dict({"type": "scene", "emitter": emitter, **target})
        shape = ""
    lamp = scene.emitters()[0] if scene.emitters() else scene.environment()
    if infinite:
        return Lit(shape, scene, lamp, True, np.zeros(3), 0.5)
    box = lamp.bbox() if not is_surface(lamp) else scene.bbox()
    low, high = np.array(box.min, dtype=float), np.array(box.max, dtype=float)
    if not np.isfinite(low + high).all() or (low > high).any():
        low = high = np.zeros(3)
    return Lit(shape, scene, lamp, False, (low + high) / 2, max(1.0, 1.5 * float(np.linalg.norm(high - low))))


def lamps(subject: Subject) -> Iterator[Lit]:
    """Yields the emitter in each scene in which it is tested: on each shape, or as it is and moved."""
    if is_surface(subject.load()):
        yield from (place(subject.load(), name) for name in shapes())
        return
    yield place(subject.load())
    if (moved := place_moved(subject)) is not None:
        yield moved


def motion(emitter: Any) -> Any:
    """The rotation of an infinite emitter, or the motion of another one, that tests apply."""
    turn = mi.ScalarTransform4f().rotate([0.48, 0.8, 0.36], 70)
    infinite = emitter.flags() & int(mi.EmitterFlags.Infinite)
    return turn if infinite else mi.ScalarTransform4f().translate([0.4, -0.2, 0.3]) @ turn


def place_moved(subject: Subject) -> Lit | None:
    """The emitter after a motion; None if it has no to_world."""
    before = subject.props["to_world"] if "to_world" in subject.props else mi.ScalarTransform4f()
    matrix = np.array(motion(subject.load()).matrix) @ np.array(before.matrix)
    try:
        lit = place(subject.load(to_world=type(before)(matrix)))
    except (RuntimeError, TypeError):
        return None
    lit.name = "moved"
    return lit


def receivers(lit: Lit, n: int, seed: int = 2, spread: bool = True) -> tuple[Any, np.ndarray]:
    """Points that receive light, and their positions: on spheres around a finite emitter, within an infinite scene."""
    u = uniform_inputs(n, 1, seed + 50)[0] if spread else np.full(n, 0.3, dtype=np.float32)
    distance = lit.radius * (2 * u if lit.infinite else 0.6 + 2 * u)
    p = (lit.centre[:, None] + directions(n, seed) * distance).astype(np.float32)
    return point(mi.Point3f(p)), p


def point(p: Any) -> Any:
    """An interaction at ``p``."""
    it = dr.zeros(mi.Interaction3f, dr.width(p))
    it.p, it.t = p, mi.Float(0)
    if mi.is_spectral:
        it.wavelengths = mi.UnpolarizedSpectrum(450, 520, 590, 650)
    return it


def seen(lit: Lit, it: Any, d: Any) -> tuple[Any, Any]:
    """What is seen from ``it`` in the direction ``d``: the interaction, and whether the emitter is there."""
    if lit.infinite:
        si = dr.zeros(mi.SurfaceInteraction3f, dr.width(d))
        si.wi, si.t, si.wavelengths = -d, mi.Float(dr.inf), it.wavelengths
        return si, mi.Bool(True)
    ray = mi.Ray3f(it.p, d)
    ray.wavelengths = it.wavelengths
    si = lit.scene.ray_intersect(ray)
    return si, si.is_valid()


def test_directions(subject: Subject, report: Report) -> None:
    """Weight, density and value of sampled directions fit together."""
    for lit in lamps(subject):
        it, p = receivers(lit, INPUTS)
        u = mi.Point2f(uniform_inputs(INPUTS, 2))
        ds, weight = lit.emitter.sample_direction(it, u)
        weight, pdf = _full(spectrum(weight)), _full(np.array(ds.pdf))[0]
        d = np.broadcast_to(np.array(ds.d), (3, INPUTS))
        delta = np.broadcast_to(np.array(ds.delta), INPUTS)
        found = (weight > 0).any(axis=0)
        where = lambda i, p=p, lit=lit: f"{lit.name} from ({', '.join(f'{x:.2f}' for x in p[:, i])})"  # noqa: E731
        least = -0.05 * np.nanmax(np.where(np.isfinite(weight), weight, 0))  # fits of a sky may be slightly negative
        right = np.isfinite(weight).all(axis=0) & (weight >= least).all(axis=0) & np.isfinite(pdf) & (pdf >= 0)
        report.require("weights and densities are finite, not negative", right | (pdf == 0), "they are not", where)
        unit = np.abs(np.linalg.norm(d, axis=0) - 1) < 1e-3
        report.require("sampled directions are unit vectors", ~found | unit, "|d| is not 1", where)
        flag = bool(lit.emitter.flags() & int(mi.EmitterFlags.Delta))
        report.require("ds.delta is the flag", ~found | (delta == flag), "it is not", where)
        try:
            value = _full(spectrum(lit.emitter.eval_direction(it, ds)))
            report.equal(
                "weight = eval_direction() / pdf", weight * np.where(flag, 1, pdf), value * found, where, tolerance=0.02
            )
        except RuntimeError as error:
            report.add("weight = eval_direction() / pdf", "not tested", str(error).splitlines()[-1])
        stated = _full(np.array(lit.emitter.pdf_direction(it, ds)))[0]
        if flag:
            report.require("pdf_direction() of an ideal emitter is 0", stated == 0, "it is not", where)
            continue
        report.equal("pdf of a sample = pdf_direction()", pdf[found], stated[found], where, tolerance=0.02)
        si, hit = seen(lit, it, ds.d)
        near = np.abs(np.array(si.t) - np.array(ds.dist)) < 1e-2 * np.array(ds.dist) if not lit.infinite else True
        same = found & _full(np.array(hit))[0].astype(bool) & near
        met = _full(spectrum(lit.emitter.eval(si)))
        report.equal("weight = eval() / pdf", (weight * pdf)[:, same], met[:, same], where, tolerance=0.02)
        if not lit.infinite:
            report.require(
                "sampled points are on the shape",
                ~found | near | (np.array(si.t) < np.array(ds.dist)),
                "no ray meets them",
                where,
                0.01,
            )


def _full(values: np.ndarray) -> np.ndarray:
    values = np.atleast_2d(values)
    return np.broadcast_to(values, (values.shape[0], INPUTS))


def test_density(subject: Subject, report: Report) -> None:
    """Directions of sample_direction() have the density of pdf_direction(), from several places."""
    for lit in lamps(subject):
        if lit.emitter.flags() & int(mi.EmitterFlags.Delta):
            return
        _, places = receivers(lit, 3, 11, spread=False)
        for place_ in places.T[:2]:
            p = mi.Point3f(*map(float, place_))
            dr.make_opaque(p)

            def sample(u: Any, lit: Lit = lit, p: Any = p) -> tuple[Any, Any]:
                ds, weight = lit.emitter.sample_direction(point(p + dr.zeros(mi.Point3f, dr.width(u))), u)
                valid = (ds.pdf > 0) & dr.any(mi.unpolarized_spectrum(weight) > 0)
                return dr.select(valid, ds.d, mi.Vector3f(0, 0, 1)), dr.select(valid, mi.Float(1), 0)

            def pdf(d: Any, lit: Lit = lit, p: Any = p) -> Any:
                it = point(p + dr.zeros(mi.Point3f, dr.width(d)))
                si, hit = seen(lit, it, d)
                value = lit.emitter.eval(si, hit)
                ds = mi.DirectionSample3f(lit.scene, si, it)
                ds.d = d
                lit_ = hit & dr.any(mi.unpolarized_spectrum(value) > 0)
                return dr.select(lit_, lit.emitter.pdf_direction(it, ds, hit), 0) + dr.zeros(mi.Float, dr.width(d))

            where = f"{lit.name} from ({', '.join(f'{x:.2f}' for x in place_)})"
            chi_squared(report, "samples follow pdf_direction()", where, sample, pdf, dimensions=2)


def test_light(subject: Subject, report: Report) -> None:
    """Receivers get the same light by sampling the emitter as by rays to everywhere."""
    for lit in lamps(subject):
        if lit.emitter.flags() & int(mi.EmitterFlags.Delta):
            return
        it, p = receivers(lit, SAMPLES, 21)
        _, weight = lit.emitter.sample_direction(it, mi.Point2f(uniform_inputs(SAMPLES, 2, 22)))
        ds, aim = lit.emitter.sample_direction(it, mi.Point2f(uniform_inputs(SAMPLES, 2, 24)))
        uniform = mi.Bool(uniform_inputs(SAMPLES, 1, 25)[0] < 0.5)
        d = dr.select(uniform, mi.Vector3f(directions_uniform(SAMPLES, 23)), ds.d)
        si, hit = seen(lit, it, d)
        ds = mi.DirectionSample3f(lit.scene, si, it)
        ds.d = d
        # Half of the rays are sampled, so that rays meet small lamps; samples on the dark side of a lamp do not count.
        hit &= uniform | dr.any(mi.unpolarized_spectrum(aim) > 0)
        aimed = dr.select(hit, lit.emitter.pdf_direction(it, ds, hit), 0)
        value = dr.select(hit, lit.emitter.eval(si, hit), 0) / (0.5 / (4 * np.pi) + 0.5 * aimed)
        for side in range(8):
            chosen = octant(p - lit.centre[:, None]) == side
            a, b = (np.broadcast_to(spectrum(v).mean(axis=0), SAMPLES)[chosen] for v in (weight, value))
            add_welch(report, "light by sampling = light by rays", a, b, f"{lit.name} octant {side}")


def add_welch(report: Report, test: str, a: np.ndarray, b: np.ndarray, where: str) -> None:
    """Adds the result of Welch's test."""
    mean_a, mean_b, p = welch(a, b)
    report.add(test, statistic=f"{mean_a:.4g} and {mean_b:.4g}", where=where, p_value=p)


def octant(p: np.ndarray) -> np.ndarray:
    """The octant of each point, 0 to 7."""
    return (p[0] > 0) + 2 * (p[1] > 0) + 4 * (p[2] > 0)


def directions_uniform(n: int, seed: int) -> np.ndarray:
    """Uniform directions, shape (3, n)."""
    u, v = uniform_inputs(n, 2, seed)
    z = 2 * u - 1
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(2 * np.pi * v), r * np.sin(2 * np.pi * v), z]).astype(np.float32)


def test_flux(subject: Subject, report: Report) -> None:
    """The light that sample_ray() sends through a sphere is the light that sample_direction() finds on it."""
    for lit in lamps(subject):
        if is_surface(lit.emitter) and lit.emitter.flags() & int(mi.EmitterFlags.DeltaDirection):
            return  # no receiver finds it by sampling
        u = uniform_inputs(SAMPLES, 5, 31)
        try:
            ray, weight = lit.emitter.sample_ray(0.0, mi.Float(u[0]), mi.Point2f(u[1:3]), mi.Point2f(u[3:]))
        except RuntimeError as error:
            report.add("flux of sample_ray() = flux by directions", "not tested", str(error).splitlines()[-1])
            return
        sent = np.broadcast_to(spectrum(weight).mean(axis=0), SAMPLES)
        o, d = (np.broadcast_to(np.array(v, dtype=float), (3, SAMPLES)) for v in (ray.o, ray.d))
        o = o - lit.centre[:, None]
        along = (o * d).sum(axis=0)
        root = along**2 - (o * o).sum(axis=0) + lit.radius**2
        t = -along + np.where(lit.infinite, -1, 1) * np.sqrt(np.maximum(root, 0))
        sent = np.where((root > 0) & (t > 0), sent, 0)
        out = o + t * d

        n = directions_uniform(SAMPLES, 32)
        p = (lit.centre[:, None] + lit.radius * n).astype(np.float32)
        ds, weight = lit.emitter.sample_direction(point(mi.Point3f(p)), mi.Point2f(uniform_inputs(SAMPLES, 2, 33)))
        cos = (np.array(ds.d) * n).sum(axis=0) * (1 if lit.infinite else -1)
        got = np.broadcast_to(spectrum(weight).mean(axis=0), SAMPLES) * np.maximum(cos, 0) * 4 * np.pi * lit.radius**2
        for side in range(8):
            where = f"{lit.name} octant {side}"
            a, b = sent * (octant(out) == side), got * (octant(n) == side)
            add_welch(report, "flux of sample_ray() = flux by directions", a, b, where)


def test_positions(subject: Subject, report: Report) -> None:
    """Sampled positions have the density of pdf_position()."""
    for lit in lamps(subject):
        if lit.infinite:
            return
        try:
            ps, weight = lit.emitter.sample_position(0.0, mi.Point2f(uniform_inputs(INPUTS, 2, 41)))
        except RuntimeError:
            return
        pdf, weight = _full(np.array(ps.pdf))[0], _full(np.atleast_2d(np.array(weight)))[0]
        report.equal("weight of a position = 1 / pdf", weight * pdf, (pdf > 0) * 1.0, lambda _, lit=lit: lit.name)
        try:
            stated = _full(np.array(lit.emitter.pdf_position(ps)))[0]
        except RuntimeError:
            continue
        report.equal("pdf of a position = pdf_position()", pdf, stated, lambda _, lit=lit: lit.name)


def test_flags(subject: Subject, report: Report) -> None:
    """is_environment() and the sampled light fit the flags."""
    emitter = subject.load()
    infinite = bool(emitter.flags() & int(mi.EmitterFlags.Infinite))
    direction = bool(emitter.flags() & int(mi.EmitterFlags.DeltaDirection))
    if not direction:
        report.require("is_environment() is the flag Infinite", [emitter.is_environment() == infinite], "it is not")


def place_light(lit: Lit, p: np.ndarray) -> np.ndarray:
    """The light that places get by one sample."""
    it = point(mi.Point3f(p))
    ds, weight = lit.emitter.sample_direction(it, mi.Point2f(uniform_inputs(p.shape[1], 2, 53)))
    return np.concatenate([np.broadcast_to(v, (3, p.shape[1])) for v in (spectrum(weight), np.array(ds.d))])


def test_transform(subject: Subject, report: Report) -> None:
    """With another to_world, the emitter's light moves along."""
    emitter = subject.load()
    if is_surface(emitter):
        return
    moved = motion(emitter)
    other = place_moved(subject)
    if other is None:
        return
    lit = place(subject.load())
    n = 2**15
    _, p = receivers(lit, n, 51)
    matrix = np.array(moved.matrix, dtype=np.float32)
    q = matrix[:3, :3] @ p + matrix[:3, 3:]
    u = mi.Point2f(uniform_inputs(n, 2, 52))
    sums = []
    for lamp, where in ((lit, p), (other, q)):
        ds, weight = lamp.emitter.sample_direction(point(mi.Point3f(where)), u)
        d, w = np.broadcast_to(np.array(ds.d), (3, n)), np.broadcast_to(spectrum(weight).mean(axis=0), n)
        sums.append((d, w))
    turned = matrix[:3, :3] @ sums[0][0]
    if np.allclose(place_light(lit, q), place_light(other, q), rtol=1e-3):
        report.add("to_world moves the light", NOTE, "to_world has no effect")
        return
    for side in range(8):
        a, b = sums[0][1] * (octant(turned) == side), sums[1][1] * (octant(sums[1][0]) == side)
        add_welch(report, "to_world moves the light", b, a, f"octant {side}")


def inputs(n: int) -> list[np.ndarray]:
    """Places of receivers, and uniform numbers."""
    u = uniform_inputs(n, 7, 61)
    return [directions(n, 62) * (1 + u[:1]), u[1:3], u[3:4], u[4:6]]


prepare = place


def values(lit: Any, p: Any, u: Any, u1: Any, u3: Any, wavelengths: Any) -> dict[str, Any]:
    """The light at given places, and the density of its direction."""
    infinite = lit.infinite
    it = dr.zeros(mi.Interaction3f, dr.width(p)) if dr.is_jit_v(mi.Float) else dr.zeros(mi.Interaction3f)
    it.p = mi.Point3f(p * (0.4 if infinite else 2.0))
    if mi.is_spectral:
        it.wavelengths = wavelengths
    ds, weight = lit.emitter.sample_direction(it, u)
    if lit.emitter.flags() & int(mi.EmitterFlags.Delta):
        return {"light by sample_direction()": weight}
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(p)) if dr.is_jit_v(mi.Float) else dr.zeros(mi.SurfaceInteraction3f)
    si.wi, si.uv, si.wavelengths, si.t = dr.normalize(p), u, it.wavelengths, mi.Float(dr.inf if infinite else 1)
    found = {"eval()": lit.emitter.eval(si)}
    if "rgb" not in mi.variant():
        return found  # the sampled directions depend on the luminance of colours
    _, sent = lit.emitter.sample_ray(0.0, u1, u, u3)
    return found | {"weight of sample_ray()": sent, "light by sample_direction()": weight * ds.pdf}


TESTS: tuple[Callable[[Subject, Report], None], ...] = (
    test_directions,
    test_density,
    test_light,
    test_flux,
    test_positions,
    test_flags,
    test_transform,
)
