"""The N-rook sampler, for any integrator (thesis, sections 4.2.1.2 and 5.3.2)."""

from __future__ import annotations

import functools

import drjit as dr
import mitsuba as mi

from ..parameters import choice, describe
from ..registry import plugin
from ..sampling.nrook import JITTERS, NRook, Permutations, grid_size
from ..sampling.sampler import PureSampler


@functools.cache
def permutations(n: int, variant: str) -> Permutations:
    """Returns the permutations of n numbers for ``variant``. Raises RuntimeError for new ones while ``dr.freeze``
    records a function: Dr.Jit would end the process.
    """
    if dr.flag(dr.JitFlag.FreezingScope):
        raise RuntimeError(f"nrook: give the sampler sample_count = {n * n} before dr.freeze records a function.")
    return Permutations(n)


@plugin("sampler", "nrook")
class NRookSampler(PureSampler):
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
         :monosp:`uniform`: a sample lies anywhere in its cell, as in the thesis. (Default: :monosp:`multi`)

     * - seed
       - |int|
       - Seed offset (Default: 0)

    Takes the samples of every pixel and dimension in :math:`N` passes of :math:`N` samples. Each pass is an N-rook
    pattern: one sample in each of :math:`N` rows and columns. From pass to pass the columns rotate by one, so that each
    of the :math:`N^2` cells has exactly one sample. After :math:`N^2` samples the same samples repeat. A sample is a
    pure function of seed, pixel, dimension and sample index; there is no state of a random generator.

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
        self.jitter = choice(props, "jitter", JITTERS)

    def set_sample_count(self, spp: int) -> None:
        """Sets the number of samples per pixel, rounded up to a square number. Rounding logs a warning."""
        n = grid_size(spp)
        super().set_sample_count(n * n)
        if n * n != spp:
            mi.Log(mi.LogLevel.Warn, f"nrook: sample count rounded up from {spp} to {n * n}.")
        self.permutations = permutations(n, mi.variant())

    def fork(self) -> NRookSampler:
        """Returns a new sampler with the same parameters and permutations, which must be seeded before use."""
        copy = super().fork()
        copy.jitter, copy.permutations = self.jitter, self.permutations
        return copy

    def points(self) -> NRook:
        return NRook(self.permutations, self.pixel, self.index % self.permutations.n**2, self.jitter)

    def to_string(self) -> str:
        return describe(self, sample_count=self.sample_count(), jitter=self.jitter)
