"""A dielectric whose index depends on the wavelength: which one a refracted ray goes with (Thomas 1986).

A spectrum holds a few wavelengths, or r, g and b. What is reflected keeps them all; what an ideally smooth interface
refracts goes another way for each, so that a ray keeps one and weighs as much more as that one was improbable. Nothing
tells a BSDF which wavelengths a ray has already lost, so it draws among all of them at each interface: right in the
mean. Who follows the ray may say by ``weights`` which of them still count. At a rough interface every wavelength
has its own facet for a direction, and its own value; the density is the mean of theirs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi

from . import fresnel, half_vectors


def sample(
    bsdf: Any,
    ctx: mi.BSDFContext,
    si: mi.SurfaceInteraction3f,
    sample1: mi.Float,
    sample2: mi.Point2f,
    active: mi.Bool,
    weights: Sequence[mi.Float] | None = None,
    together: bool = False,
) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
    """What ``sample`` of ``bsdf``, a :ref:`bsdf-prosim_dielectric`, returns for indices that depend on the wavelength.

    ``weights``: probabilities with which a smooth interface chooses a wavelength, that sum up to 1 (default: all
    alike). ``together``: all wavelengths go the way of the middle one, which is wrong, but without noise.
    """
    bs = dr.zeros(mi.BSDFSample3f)
    reflection, transmission = bsdf.enabled(ctx)
    active = active & (dr.abs(si.wi.z) > half_vectors.GRAZING)
    if active is False or not (reflection or transmission):
        return bs, mi.Spectrum(0)
    both = reflection and transmission
    m, _ = bsdf.facet(si, sample2, active)
    i_m = dr.dot(si.wi, m)
    etas = bsdf.indices.etas(si)
    p = [1 / len(etas)] * len(etas) if weights is None or bsdf.roughness is not None else list(weights)
    if together:
        p = [float(k == len(etas) // 2) for k in range(len(etas))]
    faces = [fresnel.interface(i_m, eta) for eta in etas]
    k, rest = choose(p, sample1)
    f, cos_t, eta_it, eta_ti = (pick(k, values) for values in zip(*faces, strict=True))
    reflected = rest <= f if both else mi.Mask(reflection)
    bs.wo = dr.select(reflected, mi.reflect(si.wi, m), mi.refract(si.wi, m, cos_t, eta_ti))
    bs.eta = dr.select(reflected, 1, eta_it)
    bs.sampled_component = dr.select(reflected, mi.UInt32(0), mi.UInt32(1))
    bs.sampled_type = dr.select(reflected, mi.UInt32(+bsdf.types[0]), mi.UInt32(+bsdf.types[1]))
    if bsdf.roughness is None:
        reflectance = mi.UnpolarizedSpectrum(*(face[0] for face in faces))
        ratio = mi.UnpolarizedSpectrum(*(face[2] for face in faces))
        value = bsdf.energy(ctx, si, reflected, reflectance, ratio, active)
        keeps = mi.UnpolarizedSpectrum(
            *(dr.select(reflected | together | (k == j), 1.0, 0.0) for j in range(len(etas)))
        )
        value = mi.depolarizer(value * keeps)
        mean = sum((p[j] * face[0] for j, face in enumerate(faces)), mi.Float(0))
        chosen = pick(k, p)
        pdf = dr.select(reflected, mean, chosen * (1 - f)) if both else dr.select(reflected, 1, chosen)
        pdf = dr.detach(mi.Float(pdf))
    else:
        active = active & (i_m * si.wi.z > 0) & (bs.wo.z != 0) & (((si.wi.z > 0) == (bs.wo.z > 0)) == reflected)
        active = active & (reflected | (cos_t != 0))  # where this wavelength is wholly reflected, others may not be
        value, pdf = eval_pdf(bsdf, ctx, si, bs.wo, active)
    active = active & (pdf > 0)
    bs.pdf = dr.select(active, pdf, 0)
    return bs, value / dr.select(active, dr.detach(pdf), 1) & active


def eval_pdf(
    bsdf: Any, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
) -> tuple[mi.Spectrum, mi.Float]:
    """What its ``eval_pdf`` returns for a rough interface: a value for each wavelength, and one density."""
    reflected = (si.wi.z > 0) == (wo.z > 0)
    reflection, transmission = bsdf.enabled(ctx)
    active = (
        active & (dr.abs(si.wi.z) > half_vectors.GRAZING) & (wo.z != 0) & dr.select(reflected, reflection, transmission)
    )
    if active is False or bsdf.roughness is None or not (reflection or transmission):
        return mi.Spectrum(0), mi.Float(0)
    width = bsdf.roughness.eval_1(si, active)
    etas = bsdf.indices.etas(si)
    lits, reflectances, ratios, pdf = [], [], [], mi.Float(0)
    for eta in etas:
        m, i_m, o_m = half_vectors.between(si.wi, wo, eta)
        facing = active & (i_m * si.wi.z > 0) & (o_m * wo.z > 0)
        lit, density = bsdf.facets(si, wo, m, i_m, o_m, reflected, width, eta)
        f, _, eta_it, _ = fresnel.interface(i_m, eta)
        lits.append(dr.select(facing, lit, 0))
        reflectances.append(f)
        ratios.append(eta_it)
        pdf += dr.select(facing, density * bsdf.share(ctx, reflected, f), 0) / len(etas)
    value = bsdf.energy(
        ctx, si, reflected, mi.UnpolarizedSpectrum(*reflectances), mi.UnpolarizedSpectrum(*ratios), active
    )
    return mi.depolarizer(value * mi.UnpolarizedSpectrum(*lits)) & active, pdf


def choose(p: Sequence[mi.Float | float], sample: mi.Float) -> tuple[mi.UInt32, mi.Float]:
    """``(k, rest)``: one of the probabilities ``p`` by the number ``sample``, and what is left of that, in [0, 1]."""
    k, below, width, total = mi.UInt32(0), mi.Float(0), mi.Float(p[0]), mi.Float(p[0])
    for j in range(1, len(p)):
        further = (sample >= total) & (p[j] > 0)
        k = dr.select(further, mi.UInt32(j), k)
        below, width = dr.select(further, total, below), dr.select(further, p[j], width)
        total = total + p[j]
    rest = dr.select(width > 0, (sample - below) / dr.select(width > 0, width, 1), 0)
    return k, dr.clip(rest, 0, 1)


def pick(k: mi.UInt32, values: Sequence[mi.Float | float]) -> mi.Float:
    """The ``k``-th of ``values``."""
    picked = mi.Float(values[0])
    for j in range(1, len(values)):
        picked = dr.select(k == j, values[j], picked)
    return picked
