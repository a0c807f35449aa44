"""What Mitsuba's ``blendbsdf`` and ``mask`` consist of: BSDFs with shares.

Its blend takes the probability of an ideal lobe for a density, and mixes it with those of the other BSDF (as of Mitsuba
3.9); and what it draws from an ideal lobe knows nothing of the derivative by its share.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .nested import parts

#: Class names.
MASK, BLEND = "MaskBSDF", "BlendBSDF"


def leaves(bsdf: mi.BSDF, si: mi.SurfaceInteraction3f, active: mi.Bool) -> list[tuple[mi.Float, mi.BSDF | None]]:
    """The BSDFs that ``bsdf`` mixes at ``si``, with shares that sum up to 1; None for what passes straight through."""
    kind, inner = bsdf.class_name(), parts(bsdf)
    if kind == BLEND:
        weight = dr.clip(inner["weight"].eval_1(si, active), 0, 1)
        halves = (1 - weight, inner["bsdf_0"]), (weight, inner["bsdf_1"])
        return [(share * s, leaf) for share, half in halves for s, leaf in leaves(half, si, active)]
    if kind == MASK:
        opacity = dr.clip(inner["opacity"].eval_1(si, active), 0, 1)
        return [(opacity * s, leaf) for s, leaf in leaves(inner["nested_bsdf"], si, active)] + [(1 - opacity, None)]
    return [(mi.Float(1), bsdf)]


def share(bsdf: mi.BSDF, si: mi.SurfaceInteraction3f, choice: mi.Float, active: mi.Bool) -> mi.Float:
    """The share of that which ``bsdf`` itself samples by the number ``choice``, within its blends."""
    kind, inner = bsdf.class_name(), parts(bsdf)
    if kind == BLEND:
        weight = dr.clip(inner["weight"].eval_1(si, active), 0, 1)
        w = dr.detach(weight)
        first = share(inner["bsdf_0"], si, (choice - w) / dr.maximum(1 - w, 1e-8), active)
        second = share(inner["bsdf_1"], si, choice / dr.maximum(w, 1e-8), active)
        return dr.select(choice > w, (1 - weight) * first, weight * second)
    if kind == MASK:  # which knows of the derivative by its own opacity
        a = dr.clip(dr.detach(inner["opacity"].eval_1(si, active)), 0, 1)
        nested = share(inner["nested_bsdf"], si, choice / dr.maximum(a, 1e-8), active)
        return dr.select(choice < a, nested, 1)
    return mi.Float(1)


def sample(
    ctx: mi.BSDFContext,
    si: mi.SurfaceInteraction3f,
    bsdf: mi.BSDF,
    choice: mi.Float,
    point: mi.Point2f,
    active: mi.Bool,
) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
    """A sample of all of ``bsdf``: of an ideal lobe with the probability as ``pdf``, of others with the density of all
    that are not ideal.
    """
    bs, weight, below = dr.zeros(mi.BSDFSample3f), mi.Spectrum(0), mi.Float(0)
    bs.wo = -si.wi
    mixed = leaves(bsdf, si, active)
    for part, leaf in mixed:
        known, part = part, dr.detach(part)
        chosen = active & (choice >= below) & (part > 0)
        if leaf is None:
            one, value = dr.zeros(mi.BSDFSample3f), mi.Spectrum(1)
            one.wo, one.pdf, one.eta, one.sampled_type = -si.wi, mi.Float(1), mi.Float(1), mi.UInt32(+mi.BSDFFlags.Null)
        else:
            rest = dr.clip((choice - below) / dr.select(part > 0, part, 1), 0, 1)
            one, value = leaf.sample(ctx, si, rest, point, chosen)
        one.pdf *= part
        bs, weight = dr.select(chosen, one, bs), dr.select(chosen, value * dr.relative_grad(known), weight)
        below += part
    smooth = active & mi.has_flag(bs.sampled_type, mi.BSDFFlags.Smooth) & (bs.pdf > 0)
    f, pdf = mi.Spectrum(0), mi.Float(0)
    for part, leaf in mixed:
        if leaf is not None:
            f_leaf, pdf_leaf = leaf.eval_pdf(ctx, si, bs.wo, smooth)
            f, pdf = f + part * f_leaf, pdf + part * pdf_leaf
    bs.pdf = dr.select(smooth, pdf, bs.pdf)
    return bs, dr.select(smooth, f / dr.select(pdf > 0, pdf, 1), weight)
