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


def blur(image: np.ndarray, levels: int, times: int) -> np.ndarray:
    """The mean of ``image`` around each pixel, wide and cheap: halved ``levels`` times, averaged ``times``, expanded.
    About a Gaussian of the variance (2 (4^levels - 1) / 3 + 4^levels times) pixels².
    """
    smaller = halved(image, levels + 1)
    result = average(smaller[-1], times)
    for target in reversed(smaller[:-1]):
        result = expand(result, *target.shape[:2])
    return result


def halved(image: np.ndarray, count: int) -> list[np.ndarray]:
    """``image`` and what :func:`reduce` makes of it again and again, ``count`` images in all."""
    result = [image]
    while len(result) < count:
        result.append(reduce(result[-1]))
    return result


def bands(image: np.ndarray, most: int, least_side: int) -> list[np.ndarray]:
    """``image`` as what each scale adds to the next coarser one, finest first; sides below ``least_side`` are not
    halved. What :func:`whole` makes of them is the image.
    """
    result: list[np.ndarray] = []
    while len(result) < most - 1 and min(image.shape[:2]) >= least_side:
        smaller = reduce(image)
        result.append(image - expand(smaller, *image.shape[:2]))
        image = smaller
    return [*result, image]


def whole(bands: list[np.ndarray]) -> np.ndarray:
    """The image of those :func:`bands`."""
    *finer, result = bands
    for band in reversed(finer):
        result = band + expand(result, *band.shape[:2])
    return result


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
