"""Derivatives of an image with respect to the parameters of its scene, by the very samples of the image."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .accumulate import Image
from .camera import ray_sampler, uncropped
from .estimate import Estimator
from .plan import Plan, pixels


class Derivatives:
    """An image that was rendered without derivatives, so that the number of samples in each pixel is known.

    ``image``: that image, with the number of samples as its only own channel; ``estimator``: one whose transport is
    attached.
    """

    def __init__(self, plan: Plan, estimator: Estimator, image: Image):
        self.plan, self.estimator, self.sensor, self.film = plan, estimator, estimator.sensor, estimator.sensor.film()
        self.counts = image.plane(image.sampled)
        #: The film's values of that image.
        self.storage = image.tensor()[:, :, :image.sampled]

    def develop(self, storage, aov_names):
        """The developed image of film values ``storage``, differentiably; without the integrator's own channels."""
        self.film.prepare(aov_names[:storage.shape[2] - self.estimator.channels.names.index("W") - 1])
        self.film.put_block(mi.ImageBlock(storage, mi.ScalarPoint2i(self.film.crop_offset()), border=False))
        return self.film.develop()

    def samples(self):
        """Yields ``(values, weights, pixel)`` for each pass: the film's values of one sample a lane, with derivatives;
        and for each pixel of the window within the filter's reach the weight of the sample and the pixel's index."""
        x0, y0, right, bottom = self.plan.window
        width, height, n, reach = right - x0, bottom - y0, self.plan.n, self.plan.reach
        x, y, *_ = pixels(self.plan.window)
        with uncropped(self.sensor):
            self.estimator.rays = ray_sampler(self.sensor)
            for r in range(-(-self.plan.most // n)):
                taken = dr.compress(self.counts > r * n + 0.5)
                if dr.width(taken) == 0:
                    break
                lane = dr.arange(mi.UInt32, dr.width(taken) * n)
                pixel = dr.gather(mi.UInt32, taken, lane // n)
                px, py = dr.gather(mi.Int32, x, pixel), dr.gather(mi.Int32, y, pixel)
                values, _, position = self.estimator.sample(px, py, dr.opaque(mi.UInt32, r), lane % n)
                share = dr.rcp(dr.gather(mi.Float, self.counts, pixel))
                spread = []
                for k, (weight, _) in enumerate(self.estimator.spread([mi.Float(1)], position)):
                    tx = px - x0 + k % (2 * reach + 1) - reach
                    ty = py - y0 + k // (2 * reach + 1) - reach
                    there = (tx >= 0) & (tx < width) & (ty >= 0) & (ty < height)
                    spread.append((dr.select(there, weight * share, 0), mi.UInt32(dr.select(there, ty * width + tx, 0))))
                yield values, spread

    def backward(self, gradient):
        """Propagates the derivative with respect to the film's values to the scene's parameters."""
        channels = gradient.shape[2]
        gradient = gradient.array
        for values, spread in self.samples():
            loss = mi.Float(0)
            for c, value in enumerate(values):
                if dr.grad_enabled(value):
                    loss += value * sum(w * dr.gather(mi.Float, gradient, p * channels + c) for w, p in spread)
            # The passes share the graph behind the scene's parameters: its edges must stay.
            dr.backward(dr.sum(loss), flags=dr.ADFlag.ClearVertices)

    def attached_storage(self):
        """The film's values as a tensor that depends on the scene's parameters."""
        height, width, channels = self.storage.shape
        total = dr.zeros(mi.Float, width * height * channels)
        for values, spread in self.samples():
            for c, value in enumerate(values):
                for w, p in spread:
                    dr.scatter_add(total, w * value, p * channels + c)
        return mi.TensorXf(total, (height, width, channels))
