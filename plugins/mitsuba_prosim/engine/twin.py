"""How large the error of an image is: some of it is rendered once more."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ..sampling.hash import hash32
from .error import displayed
from .estimate import Estimate
from .plan import area, pixels
from .state import State
from .work import Limit, Pass, WorkItem, photon_steps, portions


class Twin:
    """A second image, of some pixels alone, from other samples: how it differs from the first says what error both
    have, whatever the pattern of the samples is worth in this scene.

    (The variance of the samples within a pixel does not: N² stratified samples can be ten times as good.)
    """

    #: One pixel in so many, and at least so many pixels.
    ONE_IN, LEAST = 16, 4096
    #: Where the image has fewer pixels than this, whose differences could all happen to be small, each is there several
    #: times, but no more often than so many times.
    FEW, MOST = 512, 64

    def __init__(self, state: State) -> None:
        x, y, *_ = pixels(state.plan.region)
        index = state.index(x, y)
        every = max(1, min(self.ONE_IN, area(state.plan.region) // self.LEAST))
        chosen = dr.compress(hash32(hash32(index) + 1) % every == 0) if every > 1 else dr.arange(mi.UInt32, dr.width(x))
        size = dr.width(chosen)
        self.copies = min(-(-self.FEW // size), self.MOST)
        self.seed = state.plan.seed + 1
        if self.copies > 1:
            lane = dr.arange(mi.UInt32, size * self.copies)
            chosen, self.seed = dr.gather(mi.UInt32, chosen, lane % size), self.seed + lane // size
        self.x, self.y, self.index = (dr.gather(type(v), v, chosen) for v in (x, y, index))
        self.estimator = copy.copy(state.estimator)
        self.seed = hash32(self.seed)
        dr.make_opaque(self.seed)
        self.photon_seed = int(self.seed[0])
        if state.decisions.twin is None:
            state.decisions.twin = Estimate.nothing(self.estimator.values, dr.width(self.index))
        self.estimate = state.decisions.twin
        dr.eval(self.x, self.y, self.index)

    def catch_up(self, state: State, sets: int | None, limit: Limit) -> Pass:
        """A pass until the twin has as many samples as ``state``; the arguments as for :func:`.work.image_pass`."""
        end = dr.gather(mi.UInt32, state.estimate.count, self.index)
        dr.eval(end)
        steps = photon_steps(self.estimate.count, end, state, sets)
        return Pass((self._items(state, *step, limit) for step in steps), of_image=False)

    def _items(self, state: State, wanted: mi.UInt32, step: tuple[float, float], limit: Limit) -> Iterator[WorkItem]:
        for span, some, work in portions(self.estimate.count, wanted, state, step, limit):
            x, y, end = (dr.gather(type(v), v, some) for v in (self.x, self.y, wanted))
            start, seed = self.estimate.at(some), self.seed
            if self.copies > 1:
                seed = dr.gather(mi.UInt32, seed, some)
            dr.eval(x, y, start, end, seed)

            def put(sums: Estimate, some: mi.UInt32 = some) -> None:
                self.estimate.put(sums, some)
                dr.eval(self.estimate)

            plan = replace(state.plan, seed=seed, own_photon_seed=self.photon_seed)
            yield WorkItem(self.estimator, x, y, start, [(plan, end)], None, work, span, put)

    def noise(self, state: State) -> tuple[float, float]:
        """Root mean square of the error of the displayed pixels of ``state``, white being 1, and what 99 in 100 are
        within.

        The displayed values are compared, as the slope of the tone curve would be that of bright spots where there are
        some, and make little of them.
        """
        mine = state.estimate.at(self.index)
        first, second = (displayed(e.total / mi.Float(e.count)) for e in (mine, self.estimate))
        errors = np.abs(np.array(first - second, dtype=np.float64)) / 2**0.5 * state.estimator.smoothing
        return float(np.sqrt(np.mean(errors**2))), float(np.percentile(errors, 99))
