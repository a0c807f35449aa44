"""Error measures between an image and its reference image.

In this module, images are arrays of shape (height, width, 3) with linear colours; white is 1.
"""

import numpy as np


def display(image: np.ndarray) -> np.ndarray:
    """Converts a linear image to the values that a screen displays: sRGB in [0, 1]."""
    image = np.clip(image, 0, 1)
    return np.where(image <= 0.0031308, 12.92 * image, 1.055 * np.power(image, 1 / 2.4) - 0.055)


def rmse(image: np.ndarray, reference: np.ndarray) -> float:
    """Root mean squared error of the linear image against the reference, over all pixels and channels."""
    return float(np.sqrt(np.mean(np.square(image - reference))))


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
ALL = {"rmse": rmse, "flip": flip}
