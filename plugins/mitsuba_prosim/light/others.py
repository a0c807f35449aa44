"""Any emitter, by Mitsuba's own method: points and directions, area lights of any shape, environments."""

from __future__ import annotations

import mitsuba as mi

from .sample import LightSample


class Others:
    """Emitters that are sampled by their own ``sample_direction``; ``emitters``: those that no other strategy takes."""

    #: Whether all of a source is sampled, also what is below the horizon.
    whole_sphere = True
    #: Whether it can tell beforehand that a ray meets none of its sources.
    can_foresee = False

    def __init__(self, emitters):
        pass

    @staticmethod
    def takes(emitter) -> bool:
        """Whether this strategy is fit for ``emitter``: for every one."""
        return True

    def sample(self, number, emitter, si, n, sample, active, attached=False) -> LightSample:
        """A point of ``emitter``, seen from ``si``; see :meth:`.balls.Balls.sample`."""
        ds, weight = emitter.sample_direction(si, sample, active)
        return LightSample(ds.d, ds.p, ds.pdf, mi.Bool(ds.delta), weight)

    def pdf(self, number, si, n, ds, active):
        """Density per solid angle with which :meth:`sample` takes the direction ``ds``."""
        return ds.emitter.pdf_direction(si, ds, active)
