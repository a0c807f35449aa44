"""Images at several scales: the pyramid of Burt and Adelson (1983), of arrays (height, width) or with more axes."""

from __future__ import annotations

import numpy as np


def average(image: np.ndarray, times: int = 1) -> np.ndarray:
    """Weighted mean of each pixel and those within two rows and columns, so many times over: about a Gaussian whose
    standard deviation is the root of ``times``, in pixels. Beyond the border, its pixels go on.
    """
    for _ in range(times):
        image = _across(_along(image))
    return image


def reduce(image: np.ndarray) -> np.ndarray:
    """The image at half the width and height, rounded up."""
    return _across(_along(image)[::2])[:, ::2]


def expand(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """The smooth image of that size that :func:`reduce` made ``image`` of."""
    return _doubled(_doubled(image, height).swapaxes(0, 1), width).swapaxes(0, 1)


def _along(image: np.ndarray) -> np.ndarray:
    n = len(image)
    padded = np.concatenate([image[:1], image[:1], image, image[-1:], image[-1:]])
    outer = padded[:n] + padded[4:]
    inner = padded[1 : n + 1] + padded[3 : n + 3]
    return 0.0625 * outer + 0.25 * inner + 0.375 * image


def _across(image: np.ndarray) -> np.ndarray:
    return _along(image.swapaxes(0, 1)).swapaxes(0, 1)


def _doubled(image: np.ndarray, n: int) -> np.ndarray:
    padded = np.concatenate([image[:1], image, image[-1:]])
    before, after = padded[:-2], padded[2:]
    result = np.empty((n, *image.shape[1:]), image.dtype)
    result[::2] = 0.125 * (before + after) + 0.75 * image
    result[1::2] = (0.5 * (image + after))[: n // 2]
    return result
