"""What a ray of the eye knows of the photons that would have found the same light: see :mod:`..caustics.merging`."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..masks import but_not
from . import lobes
from .ray import Node, Ray
from .shapes import all_shapes
from .stage import Stage


def possible(scene: mi.Scene) -> bool:
    """Whether ``scene`` has both, glossy surfaces and ideally smooth ones."""
    flags = 0
    for shape in all_shapes(scene):
        if shape.bsdf() is not None:
            flags |= int(shape.bsdf().flags())
    return bool(lobes.has_any(flags, *lobes.GLOSSY) and lobes.has_any(flags, *lobes.IDEAL))


def onward(bs: mi.BSDFSample3f, weight: mi.Spectrum, flags: mi.UInt32) -> mi.Float:
    """What is left of a beam after a surface of these ``flags``, by its sample ``bs`` and the ``weight`` of that: the
    choice of a lobe and the loss in it; 0 where any lobe of the surface is glossy.

    Seen from either end of the beam it is the same, but for the squares of the indices that radiance is scaled by.
    """
    ideal = but_not(lobes.has_any(bs.sampled_type, *lobes.IDEAL), lobes.has_any(flags, *lobes.GLOSSY))
    return dr.select(ideal, dr.max(mi.unpolarized_spectrum(weight)) * bs.pdf, 0)


def with_reach(
    stage: Stage, ray: Ray, node: Node, following: Ray, bs: mi.BSDFSample3f, weight: mi.Spectrum, whole: mi.Bool
) -> Ray:
    """``following``, drawn from ``node``, which ``ray`` has met, as ``bs`` of this ``weight``, with its reach.

    ``whole``: the lanes whose BSDF is taken whole, where photons neither count nor go on.
    """
    flags = node.bsdf.flags()
    drawn = but_not(following.shares, whole)
    assert ray.reach is not None and stage.merging is not None
    begun = stage.merging.reach(node.si, following.d, bs.pdf)
    reach = dr.select(drawn, begun, ray.reach * onward(bs, weight, flags))
    return replace(following, reach=dr.select(whole, 0, reach))
