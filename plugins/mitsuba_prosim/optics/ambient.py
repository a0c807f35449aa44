"""The reflectance of ambient light of any BSDF, through Mitsuba's adapters.

A material states it as the BSDF attribute ``ambient``. Mitsuba's ``mask``, ``blendbsdf``, ``bumpmap`` and ``normalmap``
do not pass on the attributes of the BSDFs within: these are evaluated directly.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..compat import MAPS
from .nested import leaves, parts

#: Name of the attribute.
NAME = "ambient"


def reflectance(bsdf: mi.BSDF, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.UnpolarizedSpectrum:
    """Fraction of the ambient light that ``bsdf`` reflects towards ``si.wi``; for an array of BSDFs, call it by
    ``dr.dispatch``.

    It is 0 without the attribute ``ambient``, and on the back of BSDFs with one side.
    """
    total = mi.UnpolarizedSpectrum(0)
    for leaf in leaves(bsdf, si, active):
        if leaf.bsdf is not None:
            total += leaf.share * _of_leaf(leaf.bsdf, leaf.seen_by(si), active)
    return total


def _of_leaf(bsdf: mi.BSDF, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.UnpolarizedSpectrum:
    if bsdf.class_name() in MAPS:
        return reflectance(parts(bsdf)["nested_bsdf"], si, active)
    if not dr.all(bsdf.has_attribute(NAME)):  # in scalar variants, to evaluate it then is an error
        return mi.UnpolarizedSpectrum(0)
    visible = True if mi.has_flag(bsdf.flags(), mi.BSDFFlags.BackSide) else si.wi.z > 0
    return dr.select(active & visible, bsdf.eval_attribute(NAME, si, active), 0)
