"""The reflectance of ambient light of any BSDF, through Mitsuba's adapters.

A material states it as the BSDF attribute ``ambient``. Mitsuba's ``mask``, ``blendbsdf``, ``bumpmap`` and ``normalmap``
do not pass on the attributes of the BSDFs within: these are evaluated directly.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..compat import BLEND, MAPS, MASK, TWO_SIDED
from .nested import parts

#: Name of the attribute.
NAME = "ambient"


def reflectance(bsdf: mi.BSDF, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.UnpolarizedSpectrum:
    """Share of ambient light that ``bsdf`` reflects towards ``si.wi``; for an array of BSDFs, by ``dr.dispatch``.

    Black without the parameter, and on the back of BSDFs with one side.
    """
    kind = bsdf.class_name()
    if kind == TWO_SIDED:
        front, back = (parts(bsdf)[name] for name in ("brdf_0", "brdf_1"))
        turned = mi.SurfaceInteraction3f(si)
        turned.wi.z = dr.abs(si.wi.z)
        on_front = reflectance(front, turned, active)
        return on_front if front is back else dr.select(si.wi.z > 0, on_front, reflectance(back, turned, active))
    if kind == MASK:
        inner = parts(bsdf)
        return dr.clip(inner["opacity"].eval_1(si, active), 0, 1) * reflectance(inner["nested_bsdf"], si, active)
    if kind == BLEND:
        inner = parts(bsdf)
        first, second = (reflectance(inner[name], si, active) for name in ("bsdf_0", "bsdf_1"))
        return dr.lerp(first, second, dr.clip(inner["weight"].eval_1(si, active), 0, 1))
    if kind in MAPS:
        return reflectance(parts(bsdf)["nested_bsdf"], si, active)
    if not dr.all(bsdf.has_attribute(NAME)):  # in scalar variants, to evaluate it then is an error
        return mi.UnpolarizedSpectrum(0)
    visible = True if mi.has_flag(bsdf.flags(), mi.BSDFFlags.BackSide) else si.wi.z > 0
    return dr.select(active & visible, bsdf.eval_attribute(NAME, si, active), 0)
