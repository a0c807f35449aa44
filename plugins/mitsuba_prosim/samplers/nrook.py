"""The N-rook sampler, for any integrator (thesis, sections 4.2.1.2 and 5.3.2)."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..parameters import choice, describe, whole
from ..registry import plugin
from ..sampling.nrook import JITTERS, NRook, Permutations, grid_size, pixel_key


@plugin("sampler", "nrook")
class NRookSampler(mi.Sampler):
    r"""
    .. _sampler-nrook:

    N-rook sampler (:monosp:`nrook`)
    --------------------------------

    .. pluginparameters::

     * - sample_count
       - |int|
       - Number of samples per pixel, rounded up to a square :math:`N^2` (Default: 4)

     * - jitter
       - |string|
       - :monosp:`multi`: the :math:`N^2` samples also fill the :math:`N^2` strata of each axis (multi-jittered).
         :monosp:`uniform`: anywhere in its cell, as in the thesis. (Default: :monosp:`multi`)

     * - seed
       - |int|
       - Seed offset (Default: 0)

    Takes the samples of every pixel and dimension in :math:`N` passes of :math:`N` samples. Each pass is an N-rook
    pattern: one sample in each of :math:`N` rows and columns. From pass to pass the columns turn by one, so that all
    :math:`N^2` cells are hit exactly once. A sample is a pure function of seed, pixel, dimension and sample index;
    no state of a random generator is kept.

    .. tabs::
        .. code-tab:: xml

            <sampler type="nrook">
                <integer name="sample_count" value="25"/>
            </sampler>

        .. code-tab:: python

            'type': 'nrook',
            'sample_count': 25
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.base_seed = whole(props, "seed", 0, 0, 2**32 - 1)
        self.jitter = choice(props, "jitter", JITTERS)
        self.pixel, self.index, self.dimension = mi.UInt32(0), mi.UInt32(0), mi.UInt32(0)
        self.set_sample_count(whole(props, "sample_count", 4, 1))

    def set_sample_count(self, spp: int) -> None:
        """Sets the number of samples per pixel, rounded up to a square."""
        n = grid_size(spp)
        super().set_sample_count(n * n)
        if n * n != spp:
            mi.Log(mi.LogLevel.Warn, f"nrook: sample count rounded up from {spp} to {n * n}.")
        self.permutations = Permutations(n)
        self.samples_per_wavefront: int | None = None  # until told

    def set_samples_per_wavefront(self, samples_per_wavefront: int) -> None:
        super().set_samples_per_wavefront(samples_per_wavefront)
        self.samples_per_wavefront = samples_per_wavefront

    def fork(self) -> NRookSampler:
        copy = NRookSampler(mi.Properties())
        copy.base_seed, copy.jitter, copy.permutations = self.base_seed, self.jitter, self.permutations
        mi.Sampler.set_sample_count(copy, self.sample_count())
        copy.samples_per_wavefront = self.samples_per_wavefront
        return copy

    def clone(self) -> NRookSampler:
        copy = self.fork()
        copy.pixel, copy.index, copy.dimension = map(mi.UInt32, (self.pixel, self.index, self.dimension))
        return copy

    def seed(self, seed: int | mi.UInt32, wavefront_size: int = 0xFFFFFFFF) -> None:
        super().seed(seed, wavefront_size)
        key = mi.UInt32(seed) + self.base_seed
        lane = 0
        if dr.is_jit_v(mi.Float):
            dr.make_opaque(key)
            lane = dr.arange(mi.UInt32, self.wavefront_size())
        if self.samples_per_wavefront is None:
            # Integrators in C++, which seed with an array, tell the base class alone how many samples of a pixel lie
            # side by side: all of them, as long as the wavefront has less than 2^32 lanes.
            apart = isinstance(seed, int) or self.wavefront_size() % self.sample_count() > 0
            self.samples_per_wavefront = 1 if apart else self.sample_count()
        self.pixel = pixel_key(key, lane // self.samples_per_wavefront)
        self.index = mi.UInt32(lane % self.samples_per_wavefront)
        self.dimension = dr.opaque(mi.UInt32, 0)

    def advance(self) -> None:
        # The base class would only advance counters of its own, and come back here first (it is virtual).
        self.index += self.samples_per_wavefront
        self.dimension = dr.opaque(mi.UInt32, 0)

    def schedule_state(self) -> None:
        super().schedule_state()
        dr.schedule(self.index, self.dimension)

    def next_2d(self, active: mi.Bool = True) -> mi.Point2f:
        sample = NRook.at(self.permutations, self.pixel, self.index, self.jitter)(self.dimension)
        self.dimension += 1
        return sample

    def next_1d(self, active: mi.Bool = True) -> mi.Float:
        return self.next_2d(active).x

    def to_string(self) -> str:
        return describe(self, sample_count=self.sample_count(), jitter=self.jitter)
