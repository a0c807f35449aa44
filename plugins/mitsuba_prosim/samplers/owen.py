"""The Owen-scrambled Sobol' sampler, for any integrator."""

from ..parameters import describe
from ..registry import plugin
from ..sampling.sampler import PureSampler
from ..sampling.sobol import Sobol


@plugin("sampler", "owen")
class OwenSampler(PureSampler):
    r"""
    .. _sampler-owen:

    Owen-scrambled Sobol' sampler (:monosp:`owen`)
    ----------------------------------------------

    .. pluginparameters::

     * - sample_count
       - |int|
       - Number of samples per pixel (Default: 4)

     * - seed
       - |int|
       - Seed offset (Default: 0)

    Takes the samples of every pixel and dimension from Sobol's sequence in two dimensions. Each sequence is shuffled
    and scrambled by its own hash (Burley 2020). The sequence is unlimited: any number of samples is well distributed,
    and a power of two a little better. A sample is a pure function of seed, pixel, dimension and sample index; there is
    no state of a random generator.

    .. tabs::
        .. code-tab:: xml

            <sampler type="owen">
                <integer name="sample_count" value="24"/>
            </sampler>

        .. code-tab:: python

            'type': 'owen',
            'sample_count': 24
    """

    def points(self) -> Sobol:
        return Sobol(self.pixel, self.index)

    def to_string(self) -> str:
        return describe(self, sample_count=self.sample_count())
