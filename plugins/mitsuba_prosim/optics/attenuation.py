"""Geometric attenuation by V-shaped cavities (section 3.1.1.2; Torrance and Sparrow 1967).

The listing of the thesis divides by N·H; the denominators are V·H, as in the original paper.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def g1(cos_w: mi.Float, cos_m: mi.Float, w_m: mi.Float) -> mi.Float:
    """Visible share of a facet from direction w: min(1, 2 (N·m) (N·w) / (w·m)), for w·m > 0."""
    return dr.minimum(1, 2 * cos_m * cos_w / w_m)


def g(cos_i: mi.Float, cos_o: mi.Float, cos_m: mi.Float, i_m: mi.Float) -> mi.Float:
    """Share of a facet that is both lit and seen, by reflection: w·m is the same for both directions."""
    return g1(dr.minimum(cos_i, cos_o), cos_m, i_m)
