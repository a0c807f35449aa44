"""The base class of samplers whose samples are pure functions of seed, pixel, dimension and index."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..parameters import whole
from .nrook import NRook, pixel_key
from .sobol import Sobol


class PureSampler(mi.Sampler):
    """A sampler without the state of a random generator. A subclass gives :meth:`points`."""

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.base_seed = whole(props, "seed", 0, 0, 2**32 - 1)
        self.pixel, self.index, self.dimension = mi.UInt32(0), mi.UInt32(0), mi.UInt32(0)
        self.set_sample_count(whole(props, "sample_count", 4, 1))

    def points(self) -> NRook | Sobol:
        """The sample at hand, in every space."""
        # A subclass defines it. Mitsuba's classes cannot be abstract by abc: their metaclass is another.
        raise NotImplementedError

    def set_sample_count(self, spp: int) -> None:
        """Sets the number of samples per pixel."""
        super().set_sample_count(spp)
        self.samples_per_wavefront: int | None = None  # until it is set

    def set_samples_per_wavefront(self, samples_per_wavefront: int) -> None:
        """Sets how many samples of a pixel lie side by side in a wavefront."""
        super().set_samples_per_wavefront(samples_per_wavefront)
        self.samples_per_wavefront = samples_per_wavefront

    def fork(self) -> PureSampler:
        """A sampler of the same kind, not seeded."""
        copy = type(self)(mi.Properties())
        copy.base_seed, copy.samples_per_wavefront = self.base_seed, self.samples_per_wavefront
        mi.Sampler.set_sample_count(copy, self.sample_count())
        return copy

    def clone(self) -> PureSampler:
        """A copy that continues where this one is."""
        copy = self.fork()
        copy.pixel, copy.index, copy.dimension = map(mi.UInt32, (self.pixel, self.index, self.dimension))
        return copy

    def seed(self, seed: int | mi.UInt32, wavefront_size: int = 0xFFFFFFFF) -> None:
        """Begins with the first sample of each pixel."""
        super().seed(seed, wavefront_size)
        key = mi.UInt32(seed) + self.base_seed
        lane = 0
        if dr.is_jit_v(mi.Float):
            dr.make_opaque(key)
            lane = dr.arange(mi.UInt32, self.wavefront_size())
        if self.samples_per_wavefront is None:
            # Integrators in C++, which seed with an array, pass only to the base class how many samples of a pixel are
            # in adjacent lanes: all of them, as long as the wavefront has less than 2^32 lanes.
            separate = isinstance(seed, int) or self.wavefront_size() % self.sample_count() > 0
            self.samples_per_wavefront = 1 if separate else self.sample_count()
        self.pixel = pixel_key(key, lane // self.samples_per_wavefront)
        self.index = mi.UInt32(lane % self.samples_per_wavefront)
        self.dimension = dr.opaque(mi.UInt32, 0)

    def advance(self) -> None:
        """Goes to the next sample."""
        # The base class would only advance counters of its own, and come back here first (it is virtual).
        self.index += self.samples_per_wavefront
        self.dimension = dr.opaque(mi.UInt32, 0)

    def schedule_state(self) -> None:
        """Schedules the state for evaluation."""
        super().schedule_state()
        dr.schedule(self.index, self.dimension)

    def next_2d(self, active: mi.Bool = True) -> mi.Point2f:
        """The next two dimensions."""
        sample = self.points()(self.dimension)
        self.dimension += 1
        return sample

    def next_1d(self, active: mi.Bool = True) -> mi.Float:
        """The next dimension."""
        return self.next_2d(active).x
