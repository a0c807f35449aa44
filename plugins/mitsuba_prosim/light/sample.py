"""What a strategy gives for a source: a point of it, as it is seen from a surface."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..compat import eval_direction


@dataclass
class LightSample:
    """A point of a source. Fields are Dr.Jit arrays of one width."""

    #: ``mi.Vector3f``: unit direction to the point.
    d: mi.Vector3f
    #: ``mi.Point3f``: the point.
    p: mi.Point3f
    #: Density per solid angle with which ``d`` was drawn, 0 where there is nothing to sample.
    pdf: mi.Float
    #: Whether the density is a Dirac delta: no ray that is drawn meets this source.
    delta: mi.Bool
    #: ``mi.Spectrum``: radiance over density.
    weight: mi.Spectrum
    #: The same as a ``mi.DirectionSample3f``.
    ds: mi.DirectionSample3f


def weighed(
    emitter: mi.Emitter | mi.EmitterPtr, si: mi.SurfaceInteraction3f, ds: mi.DirectionSample3f, active: mi.Bool
) -> LightSample:
    """The sample of ``emitter`` in the direction ``ds`` (``mi.DirectionSample3f``), drawn with the density
    ``ds.pdf``.
    """
    visible = active & (ds.pdf > 0)
    ds.emitter = mi.EmitterPtr(emitter) if dr.is_jit_v(mi.Float) else emitter
    weight = eval_direction(emitter, si, ds, visible) / dr.select(visible, ds.pdf, 1)
    return LightSample(ds.d, ds.p, dr.select(visible, ds.pdf, 0), mi.Bool(False), dr.select(visible, weight, 0), ds)


def direction_sample(si: mi.SurfaceInteraction3f, d: mi.Vector3f) -> mi.DirectionSample3f:
    """A ``mi.DirectionSample3f`` in the direction ``d``, else empty."""
    ds = dr.zeros(mi.DirectionSample3f) if dr.is_jit_v(mi.Float) else mi.DirectionSample3f()
    ds.d, ds.time = d, si.time
    return ds
