"""Any emitter, by Mitsuba's own method: points and directions, area lights of any shape, environments."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from .motion import with_surface
from .sample import LightSample, direction_sample


class Others:
    """Emitters that are sampled by their own ``sample_direction``; ``emitters``: those that no other strategy takes."""

    #: Whether all of a source is sampled, also what is below the horizon.
    whole_sphere = True
    #: Whether it can tell beforehand that a ray meets none of its sources.
    can_foresee = False

    def __init__(self, emitters: Sequence[mi.Emitter]) -> None:
        pass

    @staticmethod
    def takes(emitter: mi.Emitter | mi.EmitterPtr) -> bool:
        """Whether this strategy is fit for ``emitter``: for every one."""
        return True

    def sample(
        self,
        number: int | mi.UInt32,
        emitter: mi.Emitter | mi.EmitterPtr,
        si: mi.SurfaceInteraction3f,
        n: mi.Normal3f,
        sample: mi.Point2f,
        active: mi.Bool,
    ) -> LightSample:
        """A point of ``emitter``, seen from ``si``; see :meth:`.balls.Balls.sample`."""
        ds, weight = emitter.sample_direction(si, sample, active)
        return LightSample(ds.d, ds.p, ds.pdf, mi.Bool(ds.delta), weight, ds)

    def pdf(
        self,
        number: int | mi.UInt32,
        si: mi.SurfaceInteraction3f,
        n: mi.Normal3f,
        ds: mi.DirectionSample3f,
        active: mi.Bool,
    ) -> mi.Float:
        """Density per solid angle with which :meth:`sample` takes the direction ``ds``."""
        return ds.emitter.pdf_direction(si, ds, active)

    def follows_shape(self, number: int | mi.UInt32) -> bool:
        """Whether :meth:`carried` needs to know the point of the surface."""
        return True

    def may_meet(self, number: int | mi.UInt32, o: mi.Point3f, d: mi.Vector3f) -> mi.Bool:
        """Whether the ray (o, d) meets the source ``number``: it can't be told."""
        return mi.Bool(True)

    def carried(
        self,
        number: int | mi.UInt32,
        si: mi.SurfaceInteraction3f,
        n: mi.Normal3f,
        d: mi.Vector3f,
        met: mi.SurfaceInteraction3f,
        active: mi.Bool,
    ) -> tuple[mi.DirectionSample3f, mi.Float]:
        """The direction ``d`` from ``si`` to the point ``met`` of a source, carried along; see
        :meth:`.balls.Balls.carried`.
        """
        moved, jacobian = with_surface(si.p, met)
        ds = direction_sample(si, dr.replace_grad(d, moved))
        ds.p, ds.n, ds.uv, ds.dist = met.p, met.n, met.uv, dr.norm(met.p - si.p)
        return ds, jacobian
