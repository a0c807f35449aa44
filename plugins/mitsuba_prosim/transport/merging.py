"""What a ray of the eye knows of the photons that would have found the same light: see :mod:`..photons.merging`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..masks import but_not
from ..optics.nested import all_shapes
from . import lobes
from .context import Stage
from .narrow import LIES, Narrow
from .ray import Node, Ray


def possible(scene: mi.Scene, narrow: Narrow) -> bool:
    """Whether ``scene`` has both, glossy surfaces and ideally or nearly smooth ones."""
    flags = 0
    for shape in all_shapes(scene):
        if shape.bsdf() is not None:
            flags |= int(shape.bsdf().flags())
    return narrow.table is not None or bool(lobes.has_any(flags, *lobes.GLOSSY) and lobes.has_any(flags, *lobes.IDEAL))


def share(photons: mi.Float, others: mi.Float | float = 1) -> mi.Float:
    """Share that a ray has in the light that it finds, where so many ``photons`` are to be expected for it: power
    heuristic. ``others``: what it adds up to without them.
    """
    return dr.rcp(others + dr.square(photons))


def before(ray: Ray) -> mi.Float:
    """The reach that ``ray`` has brought along, by all glossy surfaces before the one that it meets."""
    assert ray.begun is not None and ray.reach is not None
    # The square root of a square is not always the same to the bit.
    both = dr.sqrt(dr.square(ray.begun) + dr.square(ray.reach))
    return dr.select(ray.reach > 0, both, ray.begun)


def straight(ray: Ray) -> mi.Float:
    """The reach of ``ray`` where it meets a source: none lies where that lights a nearly smooth surface straight."""
    assert ray.reach is not None
    return dr.select(ray.shares, ray.reach * (1 / (1 - LIES)), ray.reach)


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
    assert stage.merging is not None
    narrow, passed = stage.merging.narrow, onward(bs, weight, flags)
    if narrow.table is not None:
        goes_on = drawn & narrow(node.bsdf, drawn)
        passed = dr.select(goes_on, dr.max(mi.unpolarized_spectrum(weight)) * (1 - LIES), passed)
    begun = dr.select(drawn, stage.merging.begun(node.si, node.bsdf, following.d, bs.pdf), 0)
    return replace(following, begun=begun, reach=dr.select(whole, 0, before(ray) * passed))


def beside(
    stage: Stage, ray: Ray, si: mi.SurfaceInteraction3f, bsdf: mi.BSDFPtr, active: mi.Bool
) -> Callable[[mi.DirectionSample3f, mi.Spectrum, mi.Float, mi.Bool], mi.Float]:
    """What a point of a source that is sampled at ``si``, where ``ray`` has met a nearly smooth surface, shares its
    light with: a function of the ``mi.DirectionSample3f``, what a lobe scatters from there, the density ``pdf`` of that
    lobe and a mask, which is ``pdf`` where no photons are to be expected.
    """
    merging = stage.merging
    if merging is None or merging.narrow.table is None:
        return lambda ds, f, pdf, active: pdf
    reach = before(ray)
    shared = active & (reach > 0) & merging.narrow(bsdf, active)

    def with_photons(ds: mi.DirectionSample3f, f: mi.Spectrum, pdf: mi.Float, active: mi.Bool) -> mi.Float:
        active = active & shared
        photons = reach * dr.max(mi.unpolarized_spectrum(f)) * merging.density(si, ds, active)
        return dr.select(active, dr.sqrt(dr.square(pdf) + dr.square(photons)), pdf)

    return with_photons
