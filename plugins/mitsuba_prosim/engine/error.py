"""The error of a mean of samples (thesis, section 4.2.1.1)."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np


def library(values: Any) -> Any:
    """Returns the module whose functions suit ``values``: Dr.Jit for a Dr.Jit array, else NumPy."""
    return dr if isinstance(values, dr.ArrayBase) else np


def variance(total: Any, squares: Any, count: Any) -> Any:
    """Returns the variance of a sample, from the sum of ``count`` samples and the sum of their squares."""
    module = library(total)
    return module.maximum(squares / count - module.square(total / count), 0) * count / module.maximum(count - 1, 1)


def standard_error(total: Any, squares: Any, count: Any) -> Any:
    """Returns the standard error of a mean of ``count`` samples, from their sum and their sum of squares (equation
    4.4).

    Samples of one N-rook pass are stratified, so the actual error of the mean is smaller than the estimate of this
    function.
    """
    return library(total).sqrt(variance(total, squares, count) / count)


def displayed(mean: Any) -> Any:
    """Returns the displayed value of a radiance: 0.1 for black, about 1 for white (radiance 1).

    The tone curve is sqrt(radiance + 0.01), which is close to the curve of sRGB except near black.
    """
    return library(mean).sqrt(library(mean).maximum(mean, 0) + 0.01)


def in_display_units(error: Any, mean: Any) -> Any:
    """Converts the error of a radiance to the error of the displayed value, by the slope of the tone curve at
    ``mean``.
    """
    return error / (2 * displayed(mean))
