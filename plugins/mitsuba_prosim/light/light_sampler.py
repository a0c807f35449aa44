"""The choice of the lamp that a path vertex samples, as by the light samplers of pbrt (Estevez and Kulla 2018).

The probability of a lamp is proportional to its importance: an estimate, always positive, of the light that it sends to
the path vertex, without shadows. Multiple importance sampling needs the probability of a lamp that a ray has hit; the
method `probability` returns it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import emitter_pointers
from ..masks import dispatch, fold
from ..sampling.hash import combine, hash32
from ..sampling.nrook import to_unit
from .emitter_methods import EmitterMethods
from .strategy import Index, Receiver

#: Number of rays that are sampled from each lamp to measure its power, place and directions.
RAYS = 256

#: Bounds that limit the error of an importance, which ignores shadows: the minimum cosine at the receiver, the minimum
#: fraction of a lamp's power that is uniform over all directions, and what is added to the importance of each lamp at a
#: receiver, relative to the mean importance of all lamps there: a third of the choices are uniform.
LEAST_COSINE, LEAST_EVEN, LEAST_SHARE = 0.02, 0.1, 0.5

#: Radius of the sphere for a lamp whose light does not fall with the distance (the sky, the sun), divided by the
#: scene's radius.
FAR = 1e3


class LightSampler:
    """Chooses one of the lamps ``emitters``, each modelled by a sphere whose intensity is uniform plus a lobe cos^n
    around an axis. For at most ``UNROLLED`` lamps, the kernel contains separate code for each lamp; else a loop.
    """

    UNROLLED = 16

    def __init__(self, scene: mi.Scene, emitters: Sequence[mi.Emitter]) -> None:
        self.count = len(emitters)
        rows = lamp_models(scene, emitters)
        # The columns 5 and 6 are the intensity and the exponent of the lobe.
        #: Whether any lamp has a lobe; and whether any lamp has a beam, which is a lobe narrower than a cosine.
        self.lobes, self.beams = bool(rows[:, 5].max() > 0), bool(rows[:, 6].max() > 1)
        self.rows: list[list[float]] = rows.tolist()
        if dr.is_jit_v(mi.Float):
            # Each row has three packets of four numbers, which load faster than columns. The table is made from a list,
            # because Dr.Jit would share the memory of a NumPy array.
            self.table = mi.Float(np.pad(rows, ((0, 0), (0, 2))).ravel().tolist())
            dr.make_opaque(self.table)

    def total(self, receiver: Receiver, active: mi.Bool) -> mi.Float:
        """Returns ``receiver.importance`` if it is known, else the sum of the importances of all lamps."""
        if receiver.importance is not None:
            return receiver.importance

        def add(k: Index, total: mi.Float) -> mi.Float:
            return total + self.importance(k, receiver, active)

        return fold(self.count, add, mi.Float(0), active, self.count <= self.UNROLLED)

    def probability(self, k: Index, receiver: Receiver, active: mi.Bool) -> mi.Float:
        """Returns the probability of the lamp ``k``."""
        least, total = self._least_and_total(receiver, active)
        return (self.importance(k, receiver, active) + least) / dr.select(total > 0, total, 1)

    def _least_and_total(self, receiver: Receiver, active: mi.Bool) -> tuple[mi.Float, mi.Float]:
        """Returns what is added to the importance of each lamp at ``receiver``, and the total over all lamps."""
        total = self.total(receiver, active)
        return total * (LEAST_SHARE / self.count), total * (1 + LEAST_SHARE)

    def choose(self, receiver: Receiver, sample: mi.Float, active: mi.Bool) -> tuple[mi.UInt32, mi.Float, mi.Float]:
        """Chooses a lamp by ``sample`` in [0, 1); returns its number, its probability, and a new number in [0, 1): the
        position of ``sample`` within the interval of the lamp, whose length is the probability.
        """
        least, total = self._least_and_total(receiver, active)
        sample = sample * total
        State = tuple[mi.UInt32, mi.Float, mi.Float, mi.Float]

        def visit(k: Index, state: State) -> State:
            chosen, importance, begin, end = state
            own_importance = self.importance(k, receiver, active) + least
            # Takes the last lamp whose interval begins at or below the number, because the sums are rounded.
            picks = sample >= end
            chosen, importance = dr.select(picks, mi.UInt32(k), chosen), dr.select(picks, own_importance, importance)
            return chosen, importance, dr.select(picks, end, begin), end + own_importance

        state = (mi.UInt32(0), mi.Float(1), mi.Float(0), mi.Float(0))
        k, importance, begin, _ = fold(self.count, visit, state, active, self.count <= self.UNROLLED)
        rest = dr.clip((sample - begin) / importance, 0, 1 - 2.0**-24)
        return k, dr.select(total > 0, importance / total, 1), rest  # the total is 0 only in inactive lanes

    def importance(self, k: Index, receiver: Receiver, active: mi.Bool) -> mi.Float:
        """Returns an estimate of the light that the lamp ``k`` sends to ``receiver``, without shadows.

        It is positive: the intensity, times the cosine at the receiver (an upper bound over the whole lamp, at least
        :data:`LEAST_COSINE`), divided by the squared distance (at least the radius of the lamp's sphere).
        """
        # The choice of a lamp has no derivatives.
        p, n, both_sides = dr.detach(receiver.si.p), dr.detach(receiver.n), receiver.both_sides
        center, radius, uniform, lobe, exponent, axis = self._lamp(k, active)
        to_lamp = center - p
        inverse = dr.rsqrt(dr.maximum(dr.squared_norm(to_lamp), dr.square(radius)))
        # Upper bounds of both cosines over the whole lamp.
        height = dr.dot(n, to_lamp)
        if both_sides is not False:
            height = dr.select(both_sides, dr.abs(height), height)
        cos_receiver = dr.clip((height + radius) * inverse, LEAST_COSINE, 1)
        intensity = uniform
        if self.lobes:  # intensity = uniform part + lobe cos^exponent; without beams, all exponents are 1
            cos_lamp = dr.clip((radius - dr.dot(axis, to_lamp)) * inverse, 0, 1)
            if self.beams:
                cos_lamp = dr.select(cos_lamp > 0, dr.power(dr.maximum(cos_lamp, 1e-6), exponent), 0)
            intensity += lobe * cos_lamp
        return intensity * cos_receiver * dr.square(inverse)

    def _lamp(self, k: Index, active: mi.Bool) -> tuple[Any, ...]:
        """Returns the model of the lamp ``k``, a row of :func:`lamp_models`; the axis may be None without lobes."""
        if dr.is_jit_v(mi.Float):
            k = mi.UInt32(k)  # a row of the table has twelve numbers: three vectors of four
            a = dr.gather(mi.Vector4f, self.table, k * 3, active)
            if not self.lobes:
                return mi.Point3f(a.x, a.y, a.z), a.w, dr.gather(mi.Float, self.table, k * 12 + 4, active), 0, 1, None
            b, c = (dr.gather(mi.Vector4f, self.table, k * 3 + j, active) for j in (1, 2))
            return mi.Point3f(a.x, a.y, a.z), a.w, b.x, b.y, b.z, mi.Vector3f(b.w, c.x, c.y)
        x, y, z, radius, uniform, lobe, exponent, *axis = self.rows[k]
        return mi.Point3f(x, y, z), radius, uniform, lobe, exponent, mi.Vector3f(axis)


def lamp_models(scene: mi.Scene, emitters: Sequence[mi.Emitter]) -> np.ndarray:
    """Returns the models of all lamps as an array of the shape (number of lamps, 10): the center of the sphere (3
    numbers), its radius, the intensity of the uniform part, and the intensity, the exponent and the axis (3 numbers) of
    the lobe.

    The model of a lamp whose light decreases with the distance is computed from rays that it emits. Any other lamp, and
    a lamp that cannot emit rays, is uniform, with a sphere of :data:`FAR` times the scene's radius. If all lamps seem
    black, all get the same intensity, so that no sum of importances is 0.
    """
    sphere = scene.bbox().bounding_sphere()
    size = max(float(sphere.radius), 1e-3)
    rows = np.tile(np.array([*np.ravel(sphere.center), FAR * size, 0, 0, 1, 0, 0, 0], dtype=float), (len(emitters), 1))
    near = [k for k, emitter in enumerate(emitters) if falls_with_distance(emitter)]
    samples = zip(near, *sample_lamps(scene, [emitters[k] for k in near], emitted_ray))
    rays = {k: lamp for k, *lamp in samples if np.isfinite(lamp[1]).all()}
    for k, (power, origins, directions) in rays.items():
        rows[k] = nearby_lamp_model(power, origins, directions, size)
    far = [k for k in range(len(emitters)) if k not in rays]
    sample = partial(light_in_scene, EmitterMethods(scene.emitters() if far else []))
    rows[far, 4] = np.square(FAR * size) * sample_lamps(scene, [emitters[k] for k in far], sample)[0].mean(1)
    if not rows[:, 4:6].any():
        rows[:, 4] = 1
    # Values are rounded to ten bits, so that rounding errors of the rays do not matter.
    mantissa, exponent = np.frexp(rows)
    return np.ldexp(np.round(mantissa * 1024) / 1024, exponent)


def falls_with_distance(emitter: mi.Emitter) -> bool:
    """Tells whether the light of ``emitter`` decreases with the square of the distance: that of surfaces (also
    ``directionalarea``) and points, unless they are ``unattenuated``.
    """
    flags, kinds = emitter.flags(), mi.EmitterFlags
    bounded = mi.has_flag(flags, kinds.Surface) or mi.has_flag(flags, kinds.DeltaPosition)
    return bounded and not mi.has_flag(flags, kinds.Infinite) and not getattr(emitter, "unattenuated", False)


def nearby_lamp_model(power: np.ndarray, origins: np.ndarray, directions: np.ndarray, size: float) -> np.ndarray:
    """Returns a row of :func:`lamp_models` for a lamp that emits rays with this ``power``, shape (rays,), and these
    ``origins`` and ``directions``, shape (rays, 3). ``size`` is the scene's radius.
    """
    low, high = origins.min(0), origins.max(0)
    center = (low + high) / 2
    radius = max(np.linalg.norm(origins - center, axis=1).max(), 1e-4 * size)
    mean = power @ directions / (power.sum() or 1)
    # The mean cosine of the lobe cos^n is (n + 1) / (n + 2). For a cosine lobe this is 2/3; a smaller mean shows a
    # uniform part. A mean above 0.7 shows a beam, and a mean below 0.1 shows a uniform lamp. The model has the mean
    # cosine of a sphere or a flat surface, except for the noise of the rays.
    cosine = min(float(np.linalg.norm(mean)), 0.9999)
    exponent = (2 * cosine - 1) / (1 - cosine) if cosine > 0.7 else 1.0
    uniform = max(1 - 1.5 * cosine, LEAST_EVEN) if cosine > 0.1 else 1.0
    flux = power.mean() / (2 * np.pi)
    axis = mean / max(np.linalg.norm(mean), 1e-9)
    return np.array([*center, radius, flux * uniform / 2, flux * (1 - uniform) * (exponent + 1), exponent, *axis])


def sample_lamps(scene: mi.Scene, emitters: Sequence[mi.Emitter], sample: Callable[..., Any]) -> list[np.ndarray]:
    """Returns the results of ``sample`` (:func:`emitted_ray` or :func:`light_in_scene`) for :data:`RAYS` fixed random
    samples of each emitter: powers of the shape (emitters, samples), negative and non-finite ones replaced by 0, and
    origins and directions of the shape (emitters, samples, 3).
    """
    count = len(emitters) * RAYS
    if not emitters:
        columns = [np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3))]
    elif dr.is_jit_v(mi.Float):
        i = dr.arange(mi.UInt32, count)
        emitter = dr.gather(mi.EmitterPtr, emitter_pointers(scene, emitters), i // RAYS)
        samples = sample(scene, emitter, combine(hash32(dr.opaque(mi.UInt32, 0)), i % RAYS))
        columns = [np.array(array, dtype=float).T for array in samples]
    else:
        samples = [sample(scene, e, combine(hash32(0), i)) for e in emitters for i in range(RAYS)]
        columns = [np.array(column, dtype=float) for column in zip(*samples)]
    # Arrays of size 1 are broadcast.
    power, *vectors = (np.broadcast_to(column, (count, *column.shape[1:])) for column in columns)
    power = np.where(np.isfinite(power), np.maximum(power, 0), 0)
    return [column.reshape(len(emitters), RAYS, *column.shape[1:]) for column in (power, *vectors)]


def emitted_ray(scene: mi.Scene, emitter: Any, key: Any) -> tuple[mi.Float, mi.Point3f, mi.Vector3f]:
    """Returns the power, origin and direction of a random ray of ``emitter``; 0 and NaN if it emits none."""

    def sample(one: mi.Emitter, *u: mi.Float) -> tuple[mi.Float, mi.Point3f, mi.Vector3f]:
        try:
            ray, weight = one.sample_ray(mi.Float(0), u[0], mi.Point2f(*u[1:3]), mi.Point2f(*u[3:5]), mi.Bool(True))
        except Exception:  # noqa: BLE001 (a user's may raise any error; Dr.Jit calls all emitters of the process)
            return mi.Float(0), mi.Point3f(dr.nan), mi.Vector3f(0)
        return brightness(mi.Spectrum(weight)), ray.o, ray.d

    return dispatch(emitter, sample, *(to_unit(combine(key, j)) for j in range(5)), mi.Bool(True))


def light_in_scene(
    methods: EmitterMethods, scene: mi.Scene, emitter: Any, key: Any
) -> tuple[mi.Float, mi.Point3f, mi.Vector3f]:
    """Returns an estimate of the irradiance, without shadows, by ``emitter`` at a random point of the scene's bounding
    box, the point, and the direction to the emitter.

    It is the mean of the colour channels, or in spectral variants the integral over the wavelengths, like the power of
    :func:`emitted_ray`.
    """
    u = [to_unit(combine(key, j)) for j in range(6)]
    box = scene.bbox()
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.p = mi.Point3f(box.min) + mi.Vector3f(*u[:3]) * mi.Vector3f(box.extents())
    spectrum = mi.MI_CIE_MAX - mi.MI_CIE_MIN if mi.is_spectral else 1
    if mi.is_spectral:
        si.wavelengths = mi.MI_CIE_MIN + spectrum * mi.sample_shifted(u[3])
    ds, weight = methods.sample_direction(emitter, si, mi.Point2f(*u[4:]), mi.Bool(True))
    return spectrum * brightness(weight), si.p, ds.d


def brightness(weight: mi.Spectrum) -> mi.Float:
    """Returns the mean of the spectrum ``weight`` over the colour channels or the wavelengths."""
    return dr.mean(mi.unpolarized_spectrum(weight), axis=0)
