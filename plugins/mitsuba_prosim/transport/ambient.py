"""The ambient term: a surface that says how it reflects ambient light adds that (section 4.1).

Mitsuba's BSDFs that hold another one do not pass on what attributes that has (but for ``twosided``), so the nested ones
are asked here.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..masks import idle
from .nested import all_within, parts


def knows_ambient(bsdf: mi.BSDF) -> bool:
    """Whether ``bsdf`` itself has the attribute ``ambient``."""
    return bool(dr.all(bsdf.has_attribute("ambient")))


def hides_ambient(bsdf: mi.BSDF) -> bool:
    """Whether one within ``bsdf`` has the attribute ``ambient``, and ``bsdf`` does not say so."""
    return not knows_ambient(bsdf) and any(knows_ambient(one) for one in all_within(bsdf))


def ambient_reflectance(bsdf: mi.BSDF, si, active):
    """Share of ambient light that ``bsdf`` reflects at ``si``: a spectrum, 0 where nothing says it.

    As in what they reflect else, ``mask`` and ``blendbsdf`` weigh, ``twosided`` turns, and bump and normal maps change
    nothing.
    """
    if idle(active):
        return mi.UnpolarizedSpectrum(0)
    if knows_ambient(bsdf):
        value = bsdf.eval_attribute("ambient", si, active)
        return dr.select(active & faces_viewer(bsdf.m_flags, si), value, 0)
    inside = parts(bsdf)
    nested = [part for part in inside.values() if isinstance(part, mi.BSDF)]
    values = [ambient_reflectance(one, si, active) for one in nested]
    if not values:
        return mi.UnpolarizedSpectrum(0)
    if bsdf.class_name() == "MaskBSDF":
        return values[0] * _share(inside["opacity"], si, active)
    if bsdf.class_name() == "BlendBSDF":
        weight = _share(inside["weight"], si, active)
        return values[0] * (1 - weight) + values[1] * weight
    if bsdf.class_name() == "TwoSidedBRDF":
        turned = mi.SurfaceInteraction3f(si)
        turned.wi = mi.Vector3f(si.wi.x, si.wi.y, -si.wi.z)
        front = mi.Frame3f.cos_theta(si.wi) > 0
        return dr.select(front, values[0], ambient_reflectance(nested[-1], turned, active))
    return values[0]


def faces_viewer(flags, si):
    """Whether a surface of the BSDF flags ``flags`` reflects to the side that it is seen from."""
    return mi.has_flag(flags, mi.BSDFFlags.BackSide) | (mi.Frame3f.cos_theta(si.wi) > 0)


def _share(texture, si, active):
    return dr.clip(texture.eval_1(si, active), 0, 1)
