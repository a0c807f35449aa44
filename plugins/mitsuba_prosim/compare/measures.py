"""Error measures between an image and its reference image, and properties of error curves (error against cost).

In this module, images are arrays of shape (height, width, 3) with linear colours; white is 1.
"""

from collections.abc import Sequence

import numpy as np


def display(image: np.ndarray) -> np.ndarray:
    """Converts a linear image to the values that a screen displays: sRGB in [0, 1]."""
    image = np.clip(image, 0, 1)
    return np.where(image <= 0.0031308, 12.92 * image, 1.055 * np.power(image, 1 / 2.4) - 0.055)


def rmse(image: np.ndarray, reference: np.ndarray) -> float:
    """Root mean squared error of the linear image against the reference, over all pixels and channels."""
    return float(np.sqrt(np.mean(np.square(image - reference))))


def tone_mapped_error(image: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Root mean square error of the channels of each pixel after a square root, shape (height, width), without
    clipping.
    """
    difference = np.sqrt(np.maximum(image, 0)) - np.sqrt(np.maximum(reference, 0))
    return np.sqrt(np.mean(np.square(difference), axis=2))


def tone_mapped_rmse(image: np.ndarray, reference: np.ndarray) -> float:
    """Root mean square of :func:`tone_mapped_error` over the pixels."""
    return float(np.sqrt(np.mean(np.square(tone_mapped_error(image, reference)))))


def percentile99(image: np.ndarray, reference: np.ndarray) -> float:
    """99th percentile of :func:`tone_mapped_error` over the pixels."""
    return float(np.percentile(tone_mapped_error(image, reference), 99))


def relative_mse(image: np.ndarray, reference: np.ndarray) -> float:
    """Mean of the squared error divided by (the squared reference value plus 0.01). Source: Rousselle et al. (2011)."""
    return float(np.mean(np.square(image - reference) / (np.square(reference) + 0.01)))


def flip_map(image: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """The error measure ꟻLIP of each pixel, 0 to 1: the difference that a viewer sees between the displayed images, at
    67 pixels per degree of the visual angle. Source: Andersson et al. (2020).
    """
    import flip_evaluator

    images = [np.ascontiguousarray(display(i), dtype=np.float32) for i in (reference, image)]
    return np.asarray(flip_evaluator.evaluate(*images, "LDR", applyMagma=False)[0])[..., 0]


def flip(image: np.ndarray, reference: np.ndarray) -> float:
    """Mean of :func:`flip_map` over the pixels."""
    return float(np.mean(flip_map(image, reference)))


#: Name of a measure -> its function of an image and its reference.
ALL = {f.__name__: f for f in (rmse, tone_mapped_rmse, percentile99, relative_mse, flip)}


def slope(costs: Sequence[float], errors: Sequence[float]) -> float:
    """Slope of an error curve in a log-log plot: -0.5 for independent samples, and -1 for ideally stratified ones."""
    return float(np.polyfit(np.log(costs), np.log(errors), 1)[0])


def cost_at(error: float, costs: Sequence[float], errors: Sequence[float]) -> float | None:
    """Cost at which an error curve reaches the value ``error``, by linear interpolation of the logarithms; None if all
    errors are above it, or if already the error at the lowest cost is below it.
    """
    order = np.argsort(costs)
    x, y = np.log(np.asarray(costs, float)[order]), np.log(np.asarray(errors, float)[order])
    # The true error never grows with the cost. Where the measured error grows, the smaller error is used.
    y = np.minimum.accumulate(y)
    log_error = np.log(error)
    if not y[-1] <= log_error <= y[0]:
        return None
    return float(np.exp(np.interp(-log_error, -y, x)))
