"""The error of a mean of samples (section 4.2.1.1), for arrays of Dr.Jit and of NumPy."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np


def library(values: Any) -> Any:
    """The module with the functions for such ``values``."""
    return dr if isinstance(values, dr.ArrayBase) else np


def variance(total: Any, squares: Any, count: Any) -> Any:
    """Variance of a sample, from the sum of ``count`` samples and the sum of their squares."""
    of = library(total)
    return of.maximum(squares / count - of.square(total / count), 0) * count / of.maximum(count - 1, 1)


def standard_error(total: Any, squares: Any, count: Any) -> Any:
    """Standard error of a mean of ``count`` samples, from their sum and their sum of squares (equation 4.4).

    Samples of one N-rook pass are stratified, so their mean is better than this estimate.
    """
    return library(total).sqrt(variance(total, squares, count) / count)


def displayed(mean: Any) -> Any:
    """Displayed value of a radiance up to a constant, white being 1: a square root, which is close to sRGB's curve."""
    return library(mean).sqrt(library(mean).maximum(mean, 0) + 0.01)


def in_display_units(error: Any, mean: Any) -> Any:
    """Error of the displayed value, by the slope of the tone curve."""
    return error / (2 * displayed(mean))
