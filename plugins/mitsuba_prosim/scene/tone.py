"""From radiance to what a screen shows."""

import numpy as np


def compress(rgb: np.ndarray) -> np.ndarray:
    """Compresses highlights to at most 1: the curve of Reinhard et al. (2002, equation 4) on the luminance.

    ``rgb``: array (height, width, 3) of linear radiance, white being 1. The luminance that only one pixel in a hundred
    exceeds becomes white; an image that is within the range of the screen stays as it is. Ratios of the channels are
    kept, as far as they fit the screen.
    """
    luminance = np.maximum(rgb @ np.array([0.2126, 0.7152, 0.0722], dtype=rgb.dtype), 0)[..., None]
    white = max(1.0, float(np.percentile(luminance, 99)))
    return rgb * (1 + luminance / white**2) / (1 + luminance)
