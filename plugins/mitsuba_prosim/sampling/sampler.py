"""The base class of samplers whose samples are pure functions of seed, pixel, dimension and index."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..parameters import whole
from .hash import hash32
from .nrook import NRook, pixel_key
from .sobol import Sobol


class PureSampler(mi.Sampler):
    """A sampler whose samples are pure functions of seed, pixel, dimension and index; see :meth:`points`."""

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.base_seed = whole(props, "seed", 0, 0, 2**32 - 1)
        self.pixel, self.index, self.dimension = mi.UInt32(0), mi.UInt32(0), mi.UInt32(0)
        self.step = 1
        self.set_sample_count(whole(props, "sample_count", 4, 1))

    def points(self) -> NRook | Sobol:
        """Returns the current sample, an object whose calls return pairs of random numbers."""
        # A subclass defines this method. The class does not use abc, because Mitsuba's classes have another metaclass.
        raise NotImplementedError

    def set_sample_count(self, spp: int) -> None:
        """Sets the number of samples per pixel."""
        super().set_sample_count(spp)
        self.samples_per_wavefront: int | None = None  # until the caller sets the number

    def set_samples_per_wavefront(self, samples_per_wavefront: int) -> None:
        """Sets the number of samples of a pixel in one wavefront, where they are in adjacent lanes."""
        super().set_samples_per_wavefront(samples_per_wavefront)
        self.samples_per_wavefront = samples_per_wavefront

    def fork(self) -> PureSampler:
        """Returns a new sampler with the same parameters, which must be seeded before use."""
        props = mi.Properties()
        props["sample_count"] = self.sample_count()
        copy = type(self)(props)
        copy.base_seed, copy.samples_per_wavefront = self.base_seed, self.samples_per_wavefront
        return copy

    def clone(self) -> PureSampler:
        """Returns a copy of this sampler, which continues at the same sample and dimension."""
        copy = self.fork()
        copy.pixel, copy.index, copy.dimension = map(mi.UInt32, (self.pixel, self.index, self.dimension))
        copy.step = self.step
        return copy

    def seed(self, seed: int | mi.UInt32, wavefront_size: int = 0xFFFFFFFF) -> None:
        """Seeds the sampler, with the parameter ``seed`` of the plugin added. ``samples_per_wavefront`` adjacent lanes
        take consecutive samples of one pixel.
        """
        super().seed(seed, wavefront_size)
        key = mi.UInt32(seed) + self.base_seed
        lane = 0
        if dr.is_jit_v(mi.Float):
            dr.make_opaque(key)
            lane = dr.arange(mi.UInt32, self.wavefront_size())
        adjacent = self.step = self.samples_per_wavefront or 1
        untold = self.samples_per_wavefront is None and not isinstance(seed, int)
        if untold and self.wavefront_size() % self.sample_count() == 0:
            # Integrators in C++ seed with an array. These integrators tell only the base class how many samples of a
            # pixel are in adjacent lanes: all of them, but with ``samples_per_pass`` or more than 2^32 samples.
            adjacent, self.step = self.sample_count(), 0
        self.pixel = pixel_key(key, lane // adjacent)
        self.index = mi.UInt32(lane % adjacent)
        self.dimension = dr.opaque(mi.UInt32, 0)

    def advance(self) -> None:
        """Starts the next sample in each lane; the other lanes of the pixel take the samples between."""
        # The method of the base class would only advance its own counters, and call this method first.
        self.index += self.step
        if self.step == 0:  # the wavefront had only some of the samples, so the next one has a pattern of its own
            self.pixel = hash32(self.pixel)
        self.dimension = dr.opaque(mi.UInt32, 0)

    def schedule_state(self) -> None:
        """Schedules the state of the sampler for evaluation by Dr.Jit."""
        super().schedule_state()
        dr.schedule(self.pixel, self.index, self.dimension)

    def next_2d(self, active: mi.Bool = True) -> mi.Point2f:
        """Returns the next two random numbers of the current sample, a point in [0, 1)²."""
        sample = self.points()(self.dimension)
        self.dimension += 1
        return sample

    def next_1d(self, active: mi.Bool = True) -> mi.Float:
        """Returns the next random number of the current sample, in [0, 1)."""
        return self.next_2d(active).x
