"""Tests of an emitter."""

from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..inputs import directions, interaction, lit, rows, rows_of, surface, uniform
from ..report import NOTE
from ..subject import on_copies
from ..tests import GROUPS, Tests, motion

#: Number of inputs without statistics, and of samples with them.
INPUTS, SAMPLES = 2**13, 2**18

#: Shapes that carry an emitter, and their scales; Mitsuba's sphere (3.9) has wrong normals if it is turned.
SHAPES = {"rectangle": [1, 0.6, 0.8], "sphere": [0.7] * 3, "cylinder": [0.6, 0.6, 1], "disk": [1, 0.6, 1], "cube": 0.6}


class Lamp:
    """An emitter in a scene, on the shape ``name`` if it needs one; light leaves or reaches the sphere ``centre``,
    ``radius``. ``motion`` is the matrix by which it has been moved.
    """

    def __init__(self, emitter: Any, name: str = "rectangle", motion: np.ndarray | None = None) -> None:
        flag = mi.EmitterFlags
        self.on_shape, self.infinite, self.ideal, self.distant = (
            bool(emitter.flags() & int(one)) for one in (flag.Surface, flag.Infinite, flag.Delta, flag.DeltaDirection)
        )
        self.name, self.motion = name if self.on_shape or motion is not None else "", motion
        turn = mi.ScalarTransform4f().translate([0.1, 0.2, -0.1]).rotate([0.6, 0, 0.8], 0 if name == "sphere" else 40)
        carrier = {"type": name, "to_world": turn.scale(SHAPES.get(name, 1)), "emitter": emitter}
        target = {"target": {"type": "sphere"}} if self.infinite else {}
        self.scene = mi.load_dict({"type": "scene", "lamp": carrier if self.on_shape else emitter, **target})
        self.emitter = on_copies((self.scene.emitters() or [self.scene.environment()])[0])
        self.centre, self.radius = np.zeros(3), 0.5
        if not self.infinite:
            box = self.scene.bbox() if self.on_shape else self.emitter.bbox()
            low, high = (np.nan_to_num(np.array(v, dtype=float), posinf=0, neginf=0) for v in (box.min, box.max))
            self.centre, self.radius = (low + high) / 2, max(0.5, 0.6 * float(np.linalg.norm(high - low)))

    def receivers(self, n: int, seed: int) -> Any:
        """Points that receive light: around a finite emitter, or within an infinite one."""
        u = uniform(n, 1, seed + 2000)
        p = self.centre[:, None] + directions(n, seed + 1) * self.radius * (2 * u if self.infinite else 1 + 3 * u)
        return mi.Point3f(p.astype(np.float32))

    def aimed(self, it: Any, n: int, seed: int) -> tuple[Any, np.ndarray, np.ndarray]:
        """Sampled directions: the sample, its direction (3, n) and its weight (channels, n)."""
        ds, weight = self.emitter.sample_direction(it, mi.Point2f(uniform(n, 2, seed)))
        dr.eval(ds, weight)
        return ds, rows(ds.d, n), rows(weight, n)

    def seen(self, it: Any, d: Any) -> tuple[Any, Any, Any]:
        """What is seen from ``it`` in the direction ``d``: interaction, whether the emitter is there, sample."""
        if self.infinite:
            si = interaction(mi.SurfaceInteraction3f, dr.width(d), wi=-d, t=mi.Float(dr.inf))
            hit = dr.full(mi.Bool, True, dr.width(d))
        else:
            si = self.scene.ray_intersect(mi.Ray3f(it.p, d, 0, it.wavelengths))
            hit = si.is_valid()
        ds = mi.DirectionSample3f(self.scene, si, it)
        ds.d = d
        return si, hit, ds


def point(p: Any, n: int | None = None) -> Any:
    """Receivers at ``p``."""
    n = n or dr.width(p)
    return interaction(mi.Interaction3f, n, p=p + dr.zeros(mi.Point3f, n))


class Emitter(Tests):
    """Tests of an emitter: on each shape that may carry it, or as it is and moved."""

    LIGHT, SMOOTH = (True,), ("eval()", "light by sample_direction()")

    def prepared(self, loaded: Any) -> Lamp:
        """The emitter in a scene."""
        return Lamp(loaded)

    def cases(self) -> Iterator[Lamp]:
        """The emitter in each scene."""
        yield (lamp := Lamp(self.subject.load()))
        if lamp.on_shape:
            yield from (Lamp(self.subject.load(), shape) for shape in list(SHAPES)[1:])
            return
        props, matrix = self.subject.props, np.array(motion().matrix)
        if lamp.infinite:
            matrix[:3, 3] = 0
        before = props["to_world"] if "to_world" in props else mi.ScalarTransform4f()
        moved = self.subject.changed(to_world=type(before)(matrix @ np.array(before.matrix)))
        if moved is not None:
            yield Lamp(moved, "moved", matrix)

    def test_directions(self, lamp: Lamp) -> None:
        """Weight, density and value of sampled directions fit together."""
        equal, require = self.report.equal, self.report.require
        it = point(lamp.receivers(INPUTS, 2))
        ds, d, weight = lamp.aimed(it, INPUTS, 4)
        pdf, found, where = rows(ds.pdf, INPUTS), (weight > 0).any(axis=0), {f"{lamp.name} from": it.p}
        least = -0.05 * np.nanmax(weight)  # a fit may be below 0
        self.report.finite("weight", weight, where, on=pdf[0] > 0, least=least)
        self.report.unit("sampled directions", d, where, on=found)
        equal("a sampled point is at its distance", ds.p - it.p, ds.d * ds.dist, where, on=found)
        outside = np.linalg.norm(rows(ds.p, INPUTS), axis=0) > 0.99
        require("points of infinite emitters lie outside the scene", outside, where, on=found & lamp.infinite)
        require("ds.delta is the flag", rows(ds.delta, INPUTS) == lamp.ideal, where, on=found)
        stated = lamp.emitter.pdf_direction(it, ds)
        equal("pdf of a sample = pdf_direction()", 0 if lamp.ideal else pdf, stated, where, on=found)
        if not lamp.ideal:
            si, hit, _ = lamp.seen(it, ds.d)
            dr.eval(si, hit)
            distance, met = rows(ds.dist, INPUTS)[0], rows(si.t, INPUTS)[0]
            near = lamp.infinite | (np.abs(met - distance) < 1e-2 * distance)
            on = found & rows(hit)[0].astype(bool) & near
            equal("weight = eval() / pdf", weight * pdf, lamp.emitter.eval(si), where, on=on)
            require("sampled points are on the shape", near | (met < distance), where, on=found, share=0.01)

    everywhere = test_directions

    def test_values(self, lamp: Lamp) -> None:
        """Weights are those of eval_direction()."""
        it = point(lamp.receivers(INPUTS, 2))
        ds, _, weight = lamp.aimed(it, INPUTS, 4)
        sent, found = weight * (1 if lamp.ideal else rows(ds.pdf)), (weight > 0).any(axis=0)
        value, where = lamp.emitter.eval_direction(it, ds), {f"{lamp.name} from": it.p}
        self.report.equal("weight = eval_direction() / pdf", sent, value, where, on=found)

    def draw(self, lamp: Lamp, ctx: Any, it: Any, u: Any) -> tuple[Any, Any, Any]:
        """A sample; the density is 0 where there is no light."""
        ds, weight = lamp.emitter.sample_direction(it, mi.Point2f(u[0], u[1]))
        return ds.d, weight, dr.select(lit(weight), ds.pdf, 0)

    def evaluate(self, lamp: Lamp, ctx: Any, it: Any, d: Any) -> tuple[Any, Any]:
        """The light that rays find, and the density where there is any."""
        si, hit, ds = lamp.seen(it, d)
        value = lamp.emitter.eval(si, hit)
        return value, dr.select(hit & lit(value), lamp.emitter.pdf_direction(it, ds, hit), 0)

    def test_density(self, lamp: Lamp) -> None:
        """Directions of sample_direction() have the density of pdf_direction(), from two places."""
        for receiver in rows(lamp.receivers(2, 11)).T if not lamp.ideal else ():
            dr.make_opaque(p := mi.Point3f(*map(float, receiver)))
            self.density(f"{lamp.name} from {receiver.round(2)}", lamp, None, partial(point, p))

    def test_light(self, lamp: Lamp) -> None:
        """Receivers get the same light from emitter samples as from rays, half of which go in all directions."""
        if lamp.ideal:
            return
        it = point(lamp.receivers(SAMPLES, 21))
        _, _, weight = lamp.aimed(it, SAMPLES, 22)
        ds, _, aim = lamp.aimed(it, SAMPLES, 24)
        everywhere = mi.Bool(uniform(SAMPLES, 1, 25)[0] < 0.5)
        d = dr.select(everywhere, mi.warp.square_to_uniform_sphere(mi.Point2f(uniform(SAMPLES, 2, 23))), ds.d)
        si, hit, ds = lamp.seen(it, d)
        hit &= everywhere | mi.Bool((aim > 0).any(axis=0))  # samples on the dark side of a lamp do not count
        density = 0.5 / (4 * np.pi) + 0.5 * dr.select(hit, lamp.emitter.pdf_direction(it, ds, hit), 0)
        value = rows(dr.select(hit, lamp.emitter.eval(si, hit), 0) / density, SAMPLES)
        side = rows(it.p) - lamp.centre[:, None]
        self.octants("light by sampling = light by rays", lamp.name, (weight, side), (value, side))

    def test_flux(self, lamp: Lamp) -> None:
        """The light that sample_ray() sends through a sphere is the light that sample_direction() finds on it."""
        if lamp.on_shape and lamp.ideal:
            return  # no receiver finds it by sampling
        u = uniform(SAMPLES, 5, 31)
        ray, sent = lamp.emitter.sample_ray(0.0, mi.Float(u[0]), mi.Point2f(u[1:3]), mi.Point2f(u[3:]))
        o, d, sent = rows_of((ray.o, ray.d, sent), SAMPLES)
        if not sent.any():
            raise NotImplementedError("sample_ray() sends no light")
        o = o - lamp.centre[:, None]
        along = (o * d).sum(axis=0)
        root = along**2 - (o * o).sum(axis=0) + lamp.radius**2
        t = -along + (-1 if lamp.infinite else 1) * np.sqrt(np.maximum(root, 0))
        sent = np.where((root > 0) & (t > 0), sent, 0)
        n = rows(mi.warp.square_to_uniform_sphere(mi.Point2f(uniform(SAMPLES, 2, 32))))
        p = mi.Point3f((lamp.centre[:, None] + lamp.radius * n).astype(np.float32))
        _, to_light, weight = lamp.aimed(point(p), SAMPLES, 33)
        cos = (to_light * n).sum(axis=0) * (1 if lamp.infinite else -1)
        got = weight * np.maximum(cos, 0) * 4 * np.pi * lamp.radius**2
        self.octants("flux of sample_ray() = flux by directions", lamp.name, (sent, o + t * d), (got, n))

    def test_positions(self, lamp: Lamp) -> None:
        """Sampled positions have the density of pdf_position(), and its reciprocal as weight."""
        if not lamp.infinite:
            ps, weight = lamp.emitter.sample_position(0.0, mi.Point2f(uniform(INPUTS, 2, 41)))
            stated, there = lamp.emitter.pdf_position(ps), rows(ps.pdf, INPUTS) > 0
            self.report.equal("weight of a position = 1 / pdf", rows(weight) * rows(ps.pdf), there, lamp.name)
            self.report.equal("pdf of a position = pdf_position()", ps.pdf, stated, lamp.name)

    def test_motion(self, other: Lamp) -> None:
        """is_environment() agrees with the flags; if to_world changes, the light moves with it."""
        if not other.distant:
            is_infinite = other.emitter.is_environment() == other.infinite
            self.report.require("is_environment() is the flag Infinite", [is_infinite])
        if (matrix := other.motion) is None:
            return
        lamp, n = Lamp(self.subject.load()), 2**15
        p = lamp.receivers(n, 51)
        q = point(mi.Point3f((matrix[:3, :3] @ rows(p) + matrix[:3, 3:]).astype(np.float32)))
        (_, d, before), (_, moved_d, after), (_, still_d, still) = (
            one.aimed(it, n, 52) for one, it in ((lamp, point(p)), (other, q), (lamp, q))
        )
        if np.allclose(after, still, rtol=1e-3) and np.allclose(moved_d, still_d, atol=1e-3):
            self.report.add("to_world moves the light", NOTE, "to_world has no effect")
        else:
            self.octants("to_world moves the light", lamp.name, (before, matrix[:3, :3] @ d), (after, moved_d))

    def inputs(self, n: int) -> list[np.ndarray]:
        """Places of receivers, and uniform numbers."""
        u = uniform(n, 6, 61)
        return [directions(n, 62) * (1 + u[:1]), u[1:3], u[3:4], u[4:]]

    def values(self, lamp: Any, p: Any, u: Any, u1: Any, u3: Any, wavelengths: Any) -> dict[str, Any]:
        """The light at given places, in given directions, and in sampled ones."""
        it = interaction(mi.Interaction3f, dr.width(p), wavelengths, p=p * (0.4 if lamp.infinite else 2.0))
        ds, weight = lamp.emitter.sample_direction(it, u)
        found: dict[str, Any] = {}
        if mi.is_spectral:
            u1 = (dr.arange(mi.UInt32, dr.width(p)) % GROUPS + 0.5) / GROUPS
        varies = lamp.emitter.flags() & int(mi.EmitterFlags.SpatiallyVarying)  # by the luminance of colours
        with suppress(RuntimeError):  # the test of the flux reports a method that is missing
            ray, sent = lamp.emitter.sample_ray(0.0, u1, u, u3)
            if mi.is_spectral:
                sent = mi.spectrum_to_srgb(mi.unpolarized_spectrum(sent), ray.wavelengths)
            found |= {} if varies and mi.is_spectral else {"weight of sample_ray()": sent}
        if lamp.ideal:
            return found | {"light by sample_direction()": weight}
        si = surface(dr.normalize(p), u, None, wavelengths)
        si.t = mi.Float(dr.inf if lamp.infinite else 1)
        found["eval()"] = lamp.emitter.eval(si)
        if "rgb" in mi.variant():  # the sampled directions depend on the luminance of colours
            found["light by sample_direction()"] = weight * ds.pdf
        return found
