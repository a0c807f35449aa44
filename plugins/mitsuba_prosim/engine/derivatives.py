"""Derivatives of an image with respect to the parameters of its scene, by the very samples of the image."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import drjit as dr
import mitsuba as mi

from .accumulate import Image
from .camera import uncropped
from .estimate import Estimator
from .plan import Plan, index_within, pixels


class Derivatives:
    """An image that was rendered without derivatives, so that the number of samples in each pixel is known.

    ``image``: that image, without own channels; ``counts``: the number of samples of each pixel of ``plan.region``;
    ``estimator``: one whose transport is attached.
    """

    def __init__(self, plan: Plan, estimator: Estimator, image: Image, counts: mi.UInt32) -> None:
        self.plan, self.estimator, self.sensor, self.film = plan, estimator, estimator.sensor, estimator.sensor.film()
        self.counts = counts
        #: The film's values of that image.
        self.storage = image.tensor()

    def develop(self, storage: mi.TensorXf, aov_names: Sequence[str]) -> mi.TensorXf:
        """The developed image of film values ``storage``, differentiably; without the integrator's own channels."""
        self.film.prepare(aov_names[: storage.shape[2] - self.estimator.channels.names.index("W") - 1])
        self.film.put_block(mi.ImageBlock(storage, mi.ScalarPoint2i(self.film.crop_offset()), border=False))
        return self.film.develop()

    def samples(self) -> Iterator[tuple[list[mi.Float], list[tuple[mi.Float, mi.UInt32]]]]:
        """Yields ``(values, weights)`` for each pass: the film's values of one sample a lane, with derivatives; and for
        each pixel within the filter's reach the weight of the sample there, 0 outside the window, and the pixel's index
        in the window.
        """
        plan = self.plan
        left, top, right, bottom = (dr.opaque(mi.Int32, v) for v in plan.window)
        offsets = range(-plan.reach, plan.reach + 1)
        x, y, *_ = pixels(plan.region)
        with uncropped(self.sensor):
            for start in itertools.count(0, plan.n):
                start = dr.opaque(mi.UInt32, start)
                taken = dr.compress(self.counts > start)
                if dr.width(taken) == 0:
                    break
                lane = dr.arange(mi.UInt32, dr.width(taken) * plan.n)
                pixel = dr.gather(mi.UInt32, taken, lane // plan.n)
                px, py = dr.gather(mi.Int32, x, pixel), dr.gather(mi.Int32, y, pixel)
                t = start + lane % plan.n
                values, _, position = self.estimator.sample(px, py, t)
                count = dr.gather(mi.UInt32, self.counts, pixel)
                share = dr.select(t < count, dr.rcp(mi.Float(count)), 0)  # the last pass may be cut short
                spread = []
                targets = [(px + dx, py + dy) for dy in offsets for dx in offsets]
                for (tx, ty), (weight, _) in zip(targets, self.estimator.spread([mi.Float(1)], position)):
                    there = (tx >= left) & (tx < right) & (ty >= top) & (ty < bottom)
                    spread.append(
                        (dr.select(there, weight * share, 0), dr.select(there, index_within(plan.window, tx, ty), 0))
                    )
                yield values, spread

    def backward(self, gradient: mi.TensorXf) -> None:
        """Propagates the derivative with respect to the film's values to the scene's parameters."""
        channels = gradient.shape[2]
        gradient = gradient.array
        for values, spread in self.samples():
            loss = mi.Float(0)
            for c, value in enumerate(values):
                if dr.grad_enabled(value):
                    loss += value * sum(w * dr.gather(mi.Float, gradient, p * channels + c) for w, p in spread)
            # The passes share the graph behind the scene's parameters: its edges must stay. The derivative of a sum,
            # but the sum itself would be a kernel of its own.
            dr.backward_from(loss, flags=dr.ADFlag.ClearVertices)
            dr.eval()  # what was scattered to the parameters, so that no pass adds to the kernel of another

    def forward(self) -> mi.TensorXf:
        """The derivative of the film's values, by those that the scene's parameters have."""
        total = dr.zeros(mi.Float, len(self.storage.array))
        channels = self.storage.shape[2]
        # Not by symbolic calls: Dr.Jit 1.5 goes forward from what one of them reads (a blend's weight) through all that
        # hangs on it, what other calls have left behind included, where it must not.
        with dr.scoped_set_flag(dr.JitFlag.SymbolicCalls, False):
            for values, spread in self.samples():
                values = [(c, value) for c, value in enumerate(values) if dr.grad_enabled(value)]
                if values:
                    # What the passes share, behind the scene's parameters, is gone through once: it keeps its
                    # derivatives.
                    dr.forward_to([value for _, value in values], flags=dr.ADFlag.ClearEdges)
                for c, value in values:
                    for w, p in spread:
                        dr.scatter_add(total, w * dr.grad(value), p * channels + c)
                dr.eval(total)  # so that the size of a kernel does not grow with the number of passes
        return mi.TensorXf(total, self.storage.shape)
