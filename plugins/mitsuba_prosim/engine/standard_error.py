"""The standard error of a mean of samples (thesis, section 4.2.1.1), also in units of the displayed image."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np


def library(values: Any) -> Any:
    """Returns the module that computes with ``values``, which is Dr.Jit for a Dr.Jit array, else NumPy."""
    return dr if isinstance(values, dr.ArrayBase) else np


def variance(total: Any, squares: Any, count: Any) -> Any:
    """Returns the variance of ``count`` samples, from sums of values and of squares; 0 for one sample."""
    module = library(total)
    return module.maximum(squares / count - module.square(total / count), 0) * count / module.maximum(count - 1, 1)


def standard_error(total: Any, squares: Any, count: Any) -> Any:
    """Returns the standard error of a mean of ``count`` samples, from their sum ``total`` and sum of ``squares``.

    The formula of the standard error (thesis, equation 4.4) holds for independent samples. The samples of one N-rook
    pass are stratified, so the actual error of their mean is smaller than the returned estimate. The estimate is 0 for
    one sample, and NaN without samples.
    """
    return library(total).sqrt(variance(total, squares, count) / count)


def displayed(mean: Any) -> Any:
    """Returns the displayed value of the radiance ``mean``: 0.1 for black, about 1 for white (radiance 1).

    The tone curve is sqrt(radiance + 0.01), which is close to the curve of sRGB except near black. Values above white
    are not clipped; a negative radiance counts as black.
    """
    return library(mean).sqrt(library(mean).maximum(mean, 0) + 0.01)


def in_display_units(error: Any, mean: Any) -> Any:
    """Returns the ``error`` times the slope of the tone curve (:func:`displayed`) at ``mean``."""
    return error / (2 * displayed(mean))
