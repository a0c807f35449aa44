"""Asking BSDFs for some of their lobes, where Mitsuba's answer otherwise.

Its ``mask`` samples nothing but what passes straight through when it is asked for all else, so it is always asked for
that too. Its ``blendbsdf`` takes the probability of an ideal lobe for a density, and mixes it with that of the other
BSDF's glossy or diffuse lobe, which takes light from the ideal one or adds some; so it is asked for either the ideal
lobes or the others, each as often. Where that does not help, as one of its BSDFs does not tell lobes apart, what it
mixes is sampled itself. (All as of Mitsuba 3.9.)
"""

from __future__ import annotations

from collections.abc import Iterator

import drjit as dr
import mitsuba as mi

from ..optics import blends
from ..optics.blends import BLEND, MASK
from ..optics.nested import all_within
from . import lobes
from .indivisible import is_indivisible
from .shapes import all_shapes


def any_careful(scene: mi.Scene) -> bool:
    """Whether any surface of ``scene``, those of instances included, is a ``mask`` or a ``blendbsdf``, or holds one."""
    bsdfs = (shape.bsdf() for shape in all_shapes(scene))
    return any(any(_within(bsdf, MASK)) or any(_within(bsdf, BLEND)) for bsdf in bsdfs if bsdf is not None)


def _within(bsdf: mi.BSDF, name: str) -> Iterator[mi.BSDF]:
    return (one for one in all_within(bsdf) if one.class_name() == name)


def _mixes(lobe: mi.BSDFContext, bsdf: mi.BSDF) -> bool:
    """Whether ``bsdf``, or one within it, is a ``blendbsdf`` with ideal and other lobes among those of ``lobe``."""
    flags = (int(one.flags()) & lobe.type_mask for one in _within(bsdf, BLEND))
    return any(lobes.has_any(each, *lobes.IDEAL) and lobes.has_any(each, *lobes.SMOOTH) for each in flags)


def _of_leaves(lobe: mi.BSDFContext, bsdf: mi.BSDF) -> bool:
    """Whether ``bsdf`` is asked for all that it mixes, of which some does not tell its lobes apart."""
    return lobes.is_everything(lobe) and _mixes(lobe, bsdf) and is_indivisible(bsdf)


def sample(
    lobe: mi.BSDFContext,
    si: mi.SurfaceInteraction3f,
    bsdf: mi.BSDF,
    choice: mi.Float,
    point: mi.Point2f,
    active: mi.Bool,
) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
    """A sample of the ``lobe`` of one ``bsdf``, as its own method has it; ``pdf`` is 0 where it is of another lobe."""
    if _of_leaves(lobe, bsdf):
        return blends.sample(lobe, si, bsdf, choice, point, active)
    masks = any(_within(bsdf, MASK))

    def part(asked: mi.BSDFContext, choice: mi.Float) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
        bs, weight = bsdf.sample(lobes.and_through(asked) if masks else asked, si, choice, point, active)
        ideal = lobes.has_any(bs.sampled_type, *lobes.IDEAL)
        weight *= dr.select(ideal, dr.relative_grad(blends.share(bsdf, si, choice, active)), 1)
        bs.pdf = dr.select((bs.sampled_type & asked.type_mask) != 0, bs.pdf, 0)
        return bs, weight

    if not _mixes(lobe, bsdf):
        return part(lobe, choice)
    ideal = part(lobes.only(lobe, *lobes.IDEAL), choice * 2)
    smooth = part(lobes.only(lobe, *lobes.SMOOTH), choice * 2 - 1)
    bs, weight = (dr.select(choice < 0.5, a, b) for a, b in zip(ideal, smooth))
    bs.pdf *= 0.5
    return bs, weight * 2


def sample_all(
    everything: mi.BSDFContext,
    si: mi.SurfaceInteraction3f,
    bsdf: mi.BSDF | mi.BSDFPtr,
    choice: mi.Float,
    point: mi.Point2f,
    active: mi.Bool,
    careful: bool,
) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
    """A sample of all lobes of ``bsdf``. ``careful``: whether anything in the scene has to be asked with care."""
    if not careful:
        return bsdf.sample(everything, si, choice, point, active)
    if not dr.is_jit_v(mi.Float):
        return sample(everything, si, bsdf, choice, point, active)
    return dr.dispatch(
        bsdf,
        lambda one, si, choice, point, active: sample(everything, si, one, choice, point, active),
        si,
        choice,
        point,
        active,
    )


def eval_pdf(
    lobe: mi.BSDFContext,
    si: mi.SurfaceInteraction3f,
    bsdf: mi.BSDF | mi.BSDFPtr,
    wo: mi.Vector3f,
    active: mi.Bool,
    careful: bool,
) -> tuple[mi.Spectrum, mi.Float]:
    """What the ``lobe`` of ``bsdf`` scatters from ``wo``, and the density of :func:`sample` there. ``careful``: whether
    anything in the scene has to be asked with care.
    """
    if not careful:
        return bsdf.eval_pdf(lobe, si, wo, active)

    def evaluated(
        one: mi.BSDF, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
    ) -> tuple[mi.Spectrum, mi.Float]:
        if _of_leaves(lobe, one):
            return one.eval_pdf(lobe, si, wo, active)
        mixes = _mixes(lobe, one)
        asked = lobes.only(lobe, *lobes.SMOOTH) if mixes else lobe
        f, pdf = one.eval_pdf(lobes.and_through(asked) if any(_within(one, MASK)) else asked, si, wo, active)
        return f, pdf * 0.5 if mixes else pdf

    if not dr.is_jit_v(mi.Float):
        return evaluated(bsdf, si, wo, active)
    return dr.dispatch(bsdf, evaluated, si, wo, active)
