"""How a surface samples a source: any emitter by Mitsuba's own method, and a constant sky by projected solid angle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import drjit as dr
import mitsuba as mi

from ..compat import CONSTANT, eval_direction

#: One emitter, or a Dr.Jit array of them.
Emitter: TypeAlias = "mi.Emitter | mi.EmitterPtr"
#: The number of a lamp: an integer, or a Dr.Jit array.
Index: TypeAlias = "int | mi.UInt32"
#: A point of a source with its density ``ds.pdf`` per solid angle, and its radiance over that density.
LightSample: TypeAlias = "tuple[mi.DirectionSample3f, mi.Spectrum]"


@dataclass
class Receiver:
    """The point that light is sampled for (pbrt's ``LightSampleContext``)."""

    si: mi.SurfaceInteraction3f | mi.Interaction3f
    #: ``mi.Normal3f``: unit normal on the viewer's side.
    n: mi.Normal3f
    #: Mask of the surfaces that light from below the horizon reaches too (rough glass), or False without such surfaces.
    both_sides: mi.Bool | bool = False
    #: Total importance of the lamps here, see :meth:`.LightSampler.total`; None where it is not known.
    importance: mi.Float | None = None


def weighted(emitter: Emitter, receiver: Receiver, ds: mi.DirectionSample3f, active: mi.Bool) -> LightSample:
    """``(ds, weight)``: the sample ``ds`` of ``emitter``, which was drawn with the density ``ds.pdf`` per solid angle,
    and radiance over density. Both ``ds.pdf`` and ``weight`` are 0 where there is nothing to sample.
    """
    visible = active & (ds.pdf > 0)
    ds.emitter = mi.EmitterPtr(emitter) if dr.is_jit_v(mi.Float) else emitter
    weight = eval_direction(emitter, receiver.si, ds, visible) / dr.select(visible, ds.pdf, 1)
    ds.pdf = dr.select(visible, ds.pdf, 0)
    return ds, dr.select(visible, weight, 0)


def direction_sample(receiver: Receiver, d: mi.Vector3f) -> mi.DirectionSample3f:
    """A ``mi.DirectionSample3f`` in the direction ``d``, else empty."""
    ds = dr.zeros(mi.DirectionSample3f) if dr.is_jit_v(mi.Float) else mi.DirectionSample3f()
    ds.d, ds.time, ds.delta = d, receiver.si.time, mi.Bool(False)
    return ds


class OtherLights:
    """Emitters that are sampled by their own ``sample_direction``: all that no other strategy can sample. Base class of
    the other strategies. ``emitters``: those of this strategy, in the order of their numbers.
    """

    #: Whether the whole source is sampled, the part below the horizon included.
    samples_below_horizon = True
    #: Whether :meth:`reparameterised` needs the point ``met``.
    follows_shape = True

    def __init__(self, emitters: Sequence[mi.Emitter]) -> None:
        pass

    @staticmethod
    def can_sample(emitter: Emitter) -> bool:
        """Whether this strategy can sample ``emitter``."""
        return True

    def sample(
        self, number: Index, emitter: Emitter, receiver: Receiver, sample: mi.Point2f, active: mi.Bool
    ) -> LightSample:
        """``(ds, weight)``: a point of the source ``number``, which is ``emitter``, for ``receiver``, with the
        density ``ds.pdf`` per solid angle; and radiance over density. ``sample``: a point in [0, 1)².
        """
        ds, weight = emitter.sample_direction(receiver.si, sample, active)
        ds.delta = mi.Bool(ds.delta)
        return ds, weight

    def pdf(self, number: Index, receiver: Receiver, ds: mi.DirectionSample3f, active: mi.Bool) -> mi.Float:
        """Density per solid angle with which :meth:`sample` takes the direction ``ds``."""
        return ds.emitter.pdf_direction(receiver.si, ds, active)

    def reparameterised(
        self, number: Index, receiver: Receiver, d: mi.Vector3f, met: mi.SurfaceInteraction3f | None, active: mi.Bool
    ) -> tuple[mi.DirectionSample3f, mi.Float]:
        """``(ds, jacobian)``, both with derivatives: the direction ``d`` to the point ``met`` of the source ``number``,
        which moves with that source; see :mod:`.reparameterisation`. ``met`` is of ``mi.RayFlags.FollowShape``.
        """
        assert met is not None
        to_point = met.p - receiver.si.p
        d2 = dr.squared_norm(to_point)
        moved = to_point * dr.rsqrt(d2)
        jacobian = dr.abs_dot(met.n, moved) / d2 * dr.norm(dr.cross(met.dp_du, met.dp_dv))
        ds = direction_sample(receiver, dr.replace_grad(d, moved))
        ds.p, ds.n, ds.uv, ds.dist = met.p, met.n, met.uv, dr.norm(to_point)
        return ds, jacobian


class ConstantSky(OtherLights):
    """Mitsuba's ``constant``: a sphere around the scene, sampled by projected solid angle. ``distance``: its radius."""

    samples_below_horizon = False

    def __init__(self, distance: float) -> None:
        self.distance = distance

    @staticmethod
    def can_sample(emitter: Emitter) -> bool:
        """Whether ``emitter`` is a constant sky."""
        return emitter.class_name() == CONSTANT

    def sample(
        self, number: Index, emitter: Emitter, receiver: Receiver, sample: mi.Point2f, active: mi.Bool
    ) -> LightSample:
        """``(ds, weight)``: a sample of the sky above the horizon of ``receiver``, cosine-weighted."""
        local = mi.warp.square_to_cosine_hemisphere(sample)
        ds = direction_sample(receiver, mi.Frame3f(receiver.n).to_world(local))
        ds.dist = mi.Float(self.distance)
        ds.p, ds.n = receiver.si.p + ds.d * self.distance, -ds.d
        ds.pdf = mi.warp.square_to_cosine_hemisphere_pdf(local)
        return weighted(emitter, receiver, ds, active)
