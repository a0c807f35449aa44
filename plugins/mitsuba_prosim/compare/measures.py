"""Error measures between an image and its reference image.

In this module, images are arrays of shape (height, width, 3) with linear colours; white is 1.
"""

import numpy as np


def rmse(image: np.ndarray, reference: np.ndarray) -> float:
    """Root mean squared error of the linear image against the reference, over all pixels and channels."""
    return float(np.sqrt(np.mean(np.square(image - reference))))


def flip_map(image: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """The error measure ꟻLIP of each pixel, 0 to 1: the difference that a viewer sees between the displayed images, at
    67 pixels per degree of the visual angle. Source: Andersson et al. (2020).
    """
    import flip_evaluator

    images = [np.ascontiguousarray(np.clip(i, 0, 1), dtype=np.float32) for i in (reference, image)]
    return np.asarray(flip_evaluator.evaluate(*images, "LDR", inputsRGB=False, applyMagma=False)[0])[..., 0]
