"""Strategies by which a surface samples a light source.

Mitsuba's method ``sample_direction`` can sample any emitter; a constant sky is sampled by projected solid angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import drjit as dr
import mitsuba as mi

from ..compat import CONSTANT, eval_direction
from .emitter_methods import Emitter, EmitterMethods, no_sample

#: The number of a lamp: an integer, or a Dr.Jit array.
Index: TypeAlias = "int | mi.UInt32"
#: A point of a light source with its density ``ds.pdf`` per solid angle, and its radiance divided by this density.
LightSample: TypeAlias = "tuple[mi.DirectionSample3f, mi.Spectrum]"


@dataclass
class Receiver:
    """The point at which direct light is computed (``LightSampleContext`` of pbrt)."""

    si: mi.SurfaceInteraction3f | mi.Interaction3f
    #: Unit normal on the viewer's side.
    n: mi.Normal3f
    #: Mask of the points that also receive light from below the horizon, such as points on rough glass; False if there
    #: are none.
    both_sides: mi.Bool | bool = False
    #: Total importance of the lamps at this point (:meth:`.LightSampler.total`); None where it is unknown.
    importance: mi.Float | None = None


def weighted(emitter: Emitter, receiver: Receiver, ds: mi.DirectionSample3f, active: mi.Bool) -> LightSample:
    """Returns the sample ``ds`` of ``emitter`` with its weight; density and weight are 0 in inactive lanes."""
    visible = active & (ds.pdf > 0)
    ds.emitter = mi.EmitterPtr(emitter) if dr.is_jit_v(mi.Float) else emitter
    weight = eval_direction(emitter, receiver.si, ds, visible) / dr.select(visible, ds.pdf, 1)
    ds.pdf = dr.select(visible, ds.pdf, 0)
    return ds, dr.select(visible, weight, 0)


def direction_sample(receiver: Receiver, d: mi.Vector3f) -> mi.DirectionSample3f:
    """Returns a sample with the direction ``d`` and the time of ``receiver``, and nothing else."""
    ds = no_sample(mi.DirectionSample3f)
    ds.d, ds.time, ds.delta = d, receiver.si.time, mi.Bool(False)
    return ds


class OtherLights:
    """Samples ``emitters``, the first of which has the number 0, by their own method ``sample_direction``."""

    #: Whether the strategy samples the whole source, including the part below the horizon.
    samples_below_horizon = True

    def __init__(self, emitters: Sequence[mi.Emitter]) -> None:
        self.methods = EmitterMethods(emitters)

    @staticmethod
    def can_sample(emitter: Emitter) -> bool:
        """Tells whether this strategy can sample ``emitter``."""
        return True

    def sample(self, k: Index, emitter: Emitter, receiver: Receiver, u: mi.Point2f, active: mi.Bool) -> LightSample:
        """Returns a sample of ``emitter``, which has the number ``k``, for ``receiver``, by ``u`` in [0, 1)²."""
        ds, weight = self.methods.sample_direction(emitter, receiver.si, u, active)
        ds.delta = mi.Bool(ds.delta)
        return ds, weight

    def pdf(self, k: Index, receiver: Receiver, ds: mi.DirectionSample3f, active: mi.Bool) -> mi.Float:
        """Returns the density per solid angle with which :meth:`sample` samples the direction ``ds``."""
        return self.methods.pdf_direction(ds.emitter, receiver.si, ds, active)

    def reparameterised(
        self, k: Index, receiver: Receiver, d: mi.Vector3f, met: mi.SurfaceInteraction3f, active: mi.Bool
    ) -> tuple[mi.DirectionSample3f, mi.Float]:
        """Returns ``(ds, jacobian)``, both with derivatives: a direction that moves with the light source ``k``.

        The value of ``ds.d`` is the direction ``d``, which leads to the point ``met`` of the source. The derivatives of
        ``met`` follow its shape (``mi.RayFlags.FollowShape``). ``jacobian`` is proportional to the solid angle of a
        small part of the source around ``met``, seen from ``receiver`` (:mod:`.reparameterisation`).
        """
        to_point = met.p - receiver.si.p
        d2 = dr.squared_norm(to_point)
        moved = to_point * dr.rsqrt(d2)
        jacobian = dr.abs_dot(met.n, moved) / d2 * dr.norm(dr.cross(met.dp_du, met.dp_dv))
        ds = direction_sample(receiver, dr.replace_grad(d, moved))
        ds.p, ds.n, ds.uv, ds.dist = met.p, met.n, met.uv, dr.norm(to_point)
        return ds, jacobian


class ConstantSky(OtherLights):
    """Samples ``constant``, a sphere of radius ``distance`` around the scene, by projected solid angle."""

    samples_below_horizon = False

    def __init__(self, distance: float) -> None:
        self.distance = distance

    @staticmethod
    def can_sample(emitter: Emitter) -> bool:
        """Tells whether ``emitter`` is a constant sky."""
        return emitter.class_name() == CONSTANT

    def sample(self, k: Index, emitter: Emitter, receiver: Receiver, u: mi.Point2f, active: mi.Bool) -> LightSample:
        """Returns a cosine-weighted sample of the sky above the horizon of ``receiver``."""
        local = mi.warp.square_to_cosine_hemisphere(u)
        ds = direction_sample(receiver, mi.Frame3f(receiver.n).to_world(local))
        ds.dist = mi.Float(self.distance)
        ds.p, ds.n = receiver.si.p + ds.d * self.distance, -ds.d
        ds.pdf = mi.warp.square_to_cosine_hemisphere_pdf(local)
        return weighted(emitter, receiver, ds, active)
