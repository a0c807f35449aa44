"""Derivatives of an image with respect to the parameters of its scene, by the very samples of the image."""

import drjit as dr
import mitsuba as mi

from ..transport.radiance import Transport
from .camera import ray_sampler
from .frame import Frame
from .window import pixels, uncropped


class DifferentiableFrame(Frame):
    """A frame that is rendered without derivatives first, so that the number of samples in each pixel is known.

    ``storage``: the film's values, as :meth:`Frame.render` returns them.
    """

    def __init__(self, integrator, scene, sensor, seed, spp):
        with dr.suspend_grad():
            super().__init__(integrator, scene, sensor, seed, spp)
            self.storage = self.render(keep_counts=True)[:, :, :len(self.film_channels())]
        self.transport = Transport(integrator, scene, attached=True)

    def develop(self, storage):
        """The developed image of film values ``storage``, differentiably; without the integrator's own channels."""
        self.film.prepare(self.integrator.aov_names()[:storage.shape[2] - self.film_channels().index("W") - 1])
        self.film.put_block(mi.ImageBlock(storage, mi.ScalarPoint2i(self.film.crop_offset()), border=False))
        return self.film.develop()

    def samples_with_gradients(self):
        """Yields ``(values, weights, pixel)`` for each pass: the film's values of one sample a lane, with derivatives;
        and for each pixel of the window within the filter's reach the weight of the sample and the pixel's index."""
        x0, y0 = (int(v) for v in self.film.crop_offset())
        width, height = (int(v) for v in self.film.crop_size())
        x, y, *_ = pixels((x0, y0, x0 + width, y0 + height))
        with uncropped(self.sensor):
            self.sample_ray = ray_sampler(self.sensor)
            for r in range(self.most_passes):
                taken = dr.compress(self.counts > r * self.n + 0.5)
                if dr.width(taken) == 0:
                    break
                lane = dr.arange(mi.UInt32, dr.width(taken) * self.n)
                pixel = dr.gather(mi.UInt32, taken, lane // self.n)
                px, py = dr.gather(mi.Int32, x, pixel), dr.gather(mi.Int32, y, pixel)
                values, _, position = self.sample(px, py, dr.opaque(mi.UInt32, r), lane % self.n)
                share = dr.rcp(dr.gather(mi.Float, self.counts, pixel))
                spread = []
                for k, (weight, _) in enumerate(self.spread([mi.Float(1)], position)):
                    tx = px - x0 + k % (2 * self.reach + 1) - self.reach
                    ty = py - y0 + k // (2 * self.reach + 1) - self.reach
                    there = (tx >= 0) & (tx < width) & (ty >= 0) & (ty < height)
                    spread.append((dr.select(there, weight * share, 0), mi.UInt32(dr.select(there, ty * width + tx, 0))))
                yield values, spread

    def backward(self, gradient):
        """Propagates the derivative with respect to the film's values to the scene's parameters."""
        channels = gradient.shape[2]
        gradient = gradient.array
        for values, spread in self.samples_with_gradients():
            loss = mi.Float(0)
            for c, value in enumerate(values):
                if dr.grad_enabled(value):
                    loss += value * sum(w * dr.gather(mi.Float, gradient, p * channels + c) for w, p in spread)
            # The passes share the graph behind the scene's parameters: its edges must stay.
            dr.backward(dr.sum(loss), flags=dr.ADFlag.ClearVertices)

    def attached_storage(self):
        """The film's values as a tensor that depends on the scene's parameters."""
        width, height = (int(v) for v in self.film.crop_size())
        channels = len(self.film_channels())
        total = dr.zeros(mi.Float, width * height * channels)
        for values, spread in self.samples_with_gradients():
            for c, value in enumerate(values):
                for w, p in spread:
                    dr.scatter_add(total, w * value, p * channels + c)
        return mi.TensorXf(total, (height, width, channels))
