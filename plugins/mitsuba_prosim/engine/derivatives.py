"""Derivatives of an image with respect to parameters of its scene, computed from the same samples as the image."""

from __future__ import annotations

from collections.abc import Iterator

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import denormals_rounded, double, dr_array
from .camera import ray_sampler, without_crop_window
from .estimator import lanes
from .film import film_values, put
from .image import Image
from .plan import indexer, pixels

#: Number of samples per kernel. A large number is fast, because Dr.Jit traces the code again for each kernel. The
#: number is limited by memory: a sample stores some 100 numbers per node.
LANES = 1 << 18


class Derivatives:
    """Computes the derivatives of a rendered image: takes the samples of the image again, now with derivatives.

    ``state`` is the :class:`.Image` of the rendered image, which has the number of samples of each pixel. The
    caller has replaced the light transport of ``state.estimator`` by a light transport that computes derivatives.
    """

    def __init__(self, state: Image) -> None:
        self.plan, self.estimator, self.sensor = state.plan, state.estimator, state.estimator.sensor
        self.estimator.rays = ray_sampler(self.sensor)  # again, now with derivatives
        self.counts = state.counts.ravel()
        #: The film's values of the rendered image; and the developed image, which is differentiable by the values.
        self.storage = film_values(state)
        dr.enable_grad(self.storage)
        put(self.sensor.film(), self.storage, self.estimator.channels.aov_names)
        self.image = self.sensor.film().develop()

    def samples(self) -> Iterator[tuple[list[mi.Float], list[tuple[mi.Float, mi.UInt32]]]]:
        """Yields pairs ``(values, splats)``, each for up to :data:`LANES` samples of the image, with derivatives.

        ``values`` has one array for each channel of the film, with one sample per lane. ``splats`` has a pair
        ``(weight, index)`` for each pixel within the filter's radius, to which a sample contributes. ``weight`` is the
        weight of the filter, divided by the number of samples of the pixel in which the sample was taken. ``index`` is
        the index of the pixel that receives the contribution, counted row by row within the crop window. ``weight`` and
        ``index`` are 0 if the receiving pixel is outside the crop window.
        """
        region, index_of = pixels(self.plan.region), indexer(self.plan.window, self.plan.window)
        offsets = range(-self.estimator.reach, self.estimator.reach + 1)
        with without_crop_window(self.sensor):
            for pixel, t, count in self.lanes():
                x, y = dr.gather(tuple, region, pixel)
                values, _, position = self.estimator.sample(self.plan, x, y, t)
                share = dr.rcp(mi.Float(count))
                weights = [weight * share for row in offsets for weight in self.estimator.weights(position, row)]
                targets = [index_of(x + column, y + row) for row in offsets for column in offsets]
                splats = zip(weights, targets)
                yield values, [(dr.select(seen, w, 0), dr.select(seen, index, 0)) for w, (index, seen) in splats]

    def lanes(self) -> Iterator[tuple[mi.UInt32, mi.UInt32, mi.UInt32]]:
        """Yields all samples of the image, up to :data:`LANES` at a time, as three arrays ``(pixel, t, count)``.

        For each sample, ``pixel`` is the index of its pixel in ``plan.region``, ``t`` is the number of the sample
        within this pixel, from 0, and ``count`` is the number of samples of the pixel.
        """
        ends = np.cumsum(self.counts, dtype=np.int64)
        for first in range(0, int(ends[-1]), LANES):
            last = min(first + LANES, int(ends[-1]))
            places = (np.clip(lane - ends + self.counts, 0, self.counts) for lane in (first, last))
            begin, end = (dr_array(place.astype(np.uint32)) for place in places)
            _, pixel, t = lanes(begin, end, last - first)
            yield pixel, t, dr.gather(mi.UInt32, dr_array(self.counts), pixel)

    @denormals_rounded()
    def backward(self, gradient: mi.TensorXf) -> None:
        """Propagates ``gradient``, the gradient with respect to the developed image, to the scene's parameters.

        Raises RuntimeError if the image does not depend on any parameter whose gradient is enabled.
        """
        dr.backward(dr.sum(self.image * gradient, axis=None))
        channels, gradient = self.storage.shape[2], dr.grad(self.storage).array
        for values, splats in self.samples():
            loss = mi.Float(0)
            for c, value in enumerate(values):
                if dr.grad_enabled(value):
                    loss += value * sum(w * dr.gather(mi.Float, gradient, p * channels + c) for w, p in splats)
            # All samples share the part of the graph from the user's variables to the scene's parameters, so the edges
            # of this part must stay. ``backward_from`` starts with the gradient 1 in each lane. This is the gradient of
            # the sum of all lanes; to compute the sum itself would need another kernel.
            dr.backward_from(loss, flags=dr.ADFlag.ClearVertices)
            dr.eval()  # evaluates the derivatives of the parameters, so that all iterations have the same kernels

    @denormals_rounded()
    def forward(self) -> mi.TensorXf:
        """Returns the derivative of the image along the gradients that are set on the scene's parameters."""
        total, channels = dr.zeros(double(), len(self.storage.array)), self.storage.shape[2]
        # Symbolic calls are off because of an error of Dr.Jit 1.5: if a call reads a variable, such as the weight of a
        # blend, then the derivatives of this variable also reach variables of earlier calls. Symbolic branches are off
        # because every call within a symbolic branch is symbolic.
        calls, branches = dr.JitFlag.SymbolicCalls, dr.JitFlag.SymbolicConditionals
        with dr.scoped_set_flag(calls, False), dr.scoped_set_flag(branches, False):
            for values, splats in self.samples():
                values = [(c, value) for c, value in enumerate(values) if dr.grad_enabled(value)]
                if values:
                    # All samples share the part of the graph from the user's variables to the scene's parameters. This
                    # part is traversed only in the first iteration, and its variables keep their derivatives.
                    dr.forward_to([value for _, value in values], flags=dr.ADFlag.ClearEdges)
                for c, value in values:
                    for w, p in splats:
                        dr.scatter_add(total, double()(w * dr.grad(value)), p * channels + c)
                dr.eval(total)  # limits the size of a kernel
        dr.set_grad(self.storage, mi.TensorXf(mi.Float(total), self.storage.shape))
        return dr.forward_to(self.image)
