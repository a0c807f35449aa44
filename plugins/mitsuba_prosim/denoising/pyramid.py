"""The image pyramid of Burt and Adelson (1983): an image, of shape (height, width, ...), at several scales."""

from __future__ import annotations

import itertools

import numpy as np


def average(image: np.ndarray, times: int = 1) -> np.ndarray:
    """Returns a smoothed image: each pixel becomes a weighted mean of the pixels within two rows and columns; this
    filter is applied ``times`` times.

    The effect of the repeated filter is about that of a Gaussian filter with a standard deviation of ``times``**0.5
    pixels. Pixels beyond the border of the image have the values of the nearest pixels at the border.
    """
    for _ in range(times):
        image = _across(_along(image))
    return image


def unevenness(image: np.ndarray) -> float:
    """Returns the mean difference of a pixel from its :func:`average`, divided by the mean of all absolute values."""
    return float(np.abs(image - average(image)).mean() / max(np.abs(image).mean(), 1e-9))


def reduce(image: np.ndarray) -> np.ndarray:
    """Returns a smoothed copy of the image at half the width and height, rounded up."""
    return _across(_along(image)[::2])[:, ::2]


def expand(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """Returns ``image`` enlarged smoothly to ``width`` x ``height``, twice the old numbers or one less."""
    return _doubled(_doubled(image, height).swapaxes(0, 1), width).swapaxes(0, 1)


def blur(image: np.ndarray, levels: int, times: int) -> np.ndarray:
    """Returns the mean over a wide window around each pixel, which is computed cheaply at a coarse scale.

    The image is reduced ``levels`` times by :func:`reduce`, smoothed by :func:`average` with ``times``, and enlarged to
    its old size by :func:`expand`. The effect of this function is about that of a Gaussian filter of the variance (2
    (4^levels - 1) / 3 + 4^levels times) pixels².
    """
    smaller = gaussian_pyramid(image, levels + 1)
    result = average(smaller[-1], times)
    for target in reversed(smaller[:-1]):
        result = expand(result, *target.shape[:2])
    return result


def gaussian_pyramid(image: np.ndarray, count: int, least_side: int = 0) -> list[np.ndarray]:
    """Returns at most ``count`` levels of the Gaussian pyramid; the first level is ``image``, and each further level
    has half the width and height.

    The pyramid has less than ``count`` levels if the width or height of a level is below ``least_side`` pixels: this
    level is then the last one.
    """
    result = [image]
    while len(result) < count and min(result[-1].shape[:2]) >= least_side:
        result.append(reduce(result[-1]))
    return result


def bands(image: np.ndarray, most: int, least_side: int) -> list[np.ndarray]:
    """Returns the Laplacian pyramid of ``image``, finest level first; at most ``most`` levels.

    Each level of the Laplacian pyramid is a level of ``gaussian_pyramid(image, most, least_side)`` minus the next
    coarser level, expanded to the same size. The last level of the Laplacian pyramid is the coarsest level of the
    Gaussian pyramid. The function :func:`from_bands` is the inverse of this function.
    """
    scales = gaussian_pyramid(image, most, least_side)
    return [fine - expand(coarse, *fine.shape[:2]) for fine, coarse in itertools.pairwise(scales)] + scales[-1:]


def from_bands(bands: list[np.ndarray]) -> np.ndarray:
    """Returns the image whose Laplacian pyramid is ``bands``; the inverse of :func:`bands`."""
    *finer, result = bands
    for band in reversed(finer):
        result = band + expand(result, *band.shape[:2])
    return result


def _along(image: np.ndarray) -> np.ndarray:
    """Returns the weighted mean of each row and two rows on each side; the border rows continue outside."""
    n = len(image)
    padded = np.concatenate([image[:1], image[:1], image, image[-1:], image[-1:]])
    outer = padded[:n] + padded[4:]
    inner = padded[1 : n + 1] + padded[3 : n + 3]
    return 0.0625 * outer + 0.25 * inner + 0.375 * image


def _across(image: np.ndarray) -> np.ndarray:
    return _along(image.swapaxes(0, 1)).swapaxes(0, 1)


def _doubled(image: np.ndarray, n: int) -> np.ndarray:
    """Returns ``image`` enlarged smoothly to ``n`` rows, about twice the number of rows of ``image``."""
    padded = np.concatenate([image[:1], image, image[-1:]])
    before, after = padded[:-2], padded[2:]
    result = np.empty_like(image, shape=(n, *image.shape[1:]))
    result[::2] = 0.125 * (before + after) + 0.75 * image
    result[1::2] = (0.5 * (image + after))[: n // 2]
    return result
