"""The scheme that an open pull request to Mitsuba (mitsuba3, number 1731) takes from Cycles: a pixel ends by its own
samples. Not one of the engine's policies, as such a decision biases the image; here to compare with.

The samples of every other pass gather in a second buffer; the difference between the two is the error (Dammertz et al.
2010). A pixel goes on where that is above the threshold, in it or in one of the eight around it.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from mitsuba_prosim.engine.camera import ray_sampler, uncropped
from mitsuba_prosim.engine.error import in_display_units
from mitsuba_prosim.engine.estimate import Estimator
from mitsuba_prosim.engine.film import Channels
from mitsuba_prosim.engine.plan import Plan, Sampling
from mitsuba_prosim.engine.state import State


def around(where: np.ndarray) -> np.ndarray:
    """The pixels of a mask and the eight around each."""
    height, width = where.shape
    padded = np.pad(where, 1)
    return np.any([padded[y : y + height, x : x + width] for y in range(3) for x in range(3)], axis=0)


def half_buffers(
    scene: mi.Scene, integrator: mi.Integrator, seed: int, n: int, threshold: float, most: int
) -> tuple[np.ndarray, float]:
    """``(image, samples)``: image of shape (height, width, 3) and the mean count, by passes of ``n`` samples, ``most``
    for a pixel, with the radiance of ``integrator``. The film has a box filter and no crop window.
    """
    sensor = scene.sensors()[0]
    film = sensor.film()
    film.prepare(integrator.aov_names())
    sampling = Sampling(n, "none", 0.0, 1, most, 0.0, 0.0, 0.0, "multi", 1 << 18)
    plan = Plan.of(sampling, film, seed, 0)
    transport = integrator.transport(scene, sensor)
    channels = Channels(film, "rgb", getattr(transport, "aov_names", ()))
    estimator = Estimator(plan, scene, sensor, transport, channels)
    state = State(plan, estimator, [])
    width, height = (int(v) for v in film.size())
    with uncropped(sensor):
        estimator.rays = ray_sampler(sensor)
        half = mi.Float(0)
        going = np.ones((height, width), bool)
        for t in range(0, most, 2 * n):
            active = mi.UInt32(going.ravel())
            for count in (t + n, t + 2 * n):
                before = mi.Float(state.estimate.total)  # a copy: the state grows in place
                state.grow(dr.maximum(state.estimate.count, active * dr.opaque(mi.UInt32, count)))
                if count == t + n:
                    half = half + state.estimate.total - before
                    dr.eval(half)
            count = mi.Float(state.estimate.count)
            mean = state.estimate.total / count
            error = in_display_units(dr.abs(mean - 2 * half / count), mean)
            going &= around(np.array(error > threshold).reshape(height, width))
            if not going.any():
                break
    image = np.array(state.image().tensor(), dtype=np.float64)
    return image[..., :3] / image[..., channels.names.index("W"), None], float(np.mean(np.array(state.counts())))
