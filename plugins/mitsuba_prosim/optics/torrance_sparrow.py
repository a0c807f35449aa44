"""Reflection by facets in V-shaped cavities (section 3.1.1, equation 3.1; Torrance and Sparrow 1967), but for Fresnel's
reflectance.

Facets hide each other (section 3.1.1.2). The listing of the thesis divides by N·H there; the denominators are V·H, as
in the original paper.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from . import half_vectors
from .facets import Distribution


def g1(cos_w: mi.Float, cos_m: mi.Float, w_m: mi.Float) -> mi.Float:
    """Visible share of a facet from direction w: min(1, 2 (N·m) (N·w) / (w·m)), for w·m > 0."""
    return dr.minimum(1, 2 * cos_m * cos_w / w_m)


def g(cos_i: mi.Float, cos_o: mi.Float, cos_m: mi.Float, i_m: mi.Float) -> mi.Float:
    """Fraction of a facet that is both lit and visible, by reflection: w·m is the same for both directions."""
    return g1(dr.minimum(cos_i, cos_o), cos_m, i_m)


def eval_pdf(
    wi: mi.Vector3f, wo: mi.Vector3f, facets: Distribution, roughness: mi.Float
) -> tuple[mi.Float, mi.Float, mi.Float]:
    """``(i_m, value, pdf)`` for a pair of unit directions above the surface, the cosine of ``wi`` above
    `half_vectors.GRAZING`.

    ``i_m`` is the cosine between ``wi`` and the facet, of which Fresnel's reflectance is to be taken; ``value`` the
    BRDF without it, times the cosine of ``wo``: D G / (4 cos_i); ``pdf`` the density per solid angle with which
    :func:`.visible.sample` leads to ``wo``.
    """
    m, i_m = half_vectors.reflecting(wi, wo)
    density = facets.D(m, roughness) / (4 * wi.z)
    return i_m, density * g(wi.z, wo.z, m.z, i_m), density * g1(wi.z, m.z, i_m)
