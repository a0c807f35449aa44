"""The error of a mean of samples (section 4.2.1.1)."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def variance(total: mi.Float, squares: mi.Float, count: mi.Float) -> mi.Float:
    """Variance of a sample, from the sum of ``count`` samples and the sum of their squares."""
    return dr.maximum(squares / count - dr.square(total / count), 0) * count / dr.maximum(count - 1, 1)


def standard_error(total: mi.Float, squares: mi.Float, count: mi.Float) -> mi.Float:
    """Standard error of a mean of ``count`` samples, from their sum and their sum of squares (equation 4.4).

    Samples of one N-rook pass are stratified, so their mean is better than this estimate.
    """
    return dr.sqrt(variance(total, squares, count) / count)


def displayed(mean: mi.Float) -> mi.Float:
    """Displayed value of a radiance up to a constant, white being 1: a square root, which is close to sRGB's curve."""
    return dr.sqrt(dr.maximum(mean, 0) + 0.01)


def in_display_units(error: mi.Float, mean: mi.Float) -> mi.Float:
    """Error of the displayed value, by the slope of the tone curve."""
    return error / (2 * displayed(mean))
