"""The pyramid of Burt and Adelson (1983): images (arrays of shape (height, width, ...)) at several scales."""

from __future__ import annotations

import itertools

import numpy as np


def average(image: np.ndarray, times: int = 1) -> np.ndarray:
    """Weighted mean of each pixel and its neighbours within two rows and columns, repeated ``times`` times: about a
    Gaussian with a standard deviation of ``times``**0.5 pixels. The pixels of the border continue beyond it.
    """
    for _ in range(times):
        image = _across(_along(image))
    return image


def reduce(image: np.ndarray) -> np.ndarray:
    """The image at half the width and height, rounded up."""
    return _across(_along(image)[::2])[:, ::2]


def expand(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """A smooth image of that size, the opposite of :func:`reduce`."""
    return _doubled(_doubled(image, height).swapaxes(0, 1), width).swapaxes(0, 1)


def blur(image: np.ndarray, levels: int, times: int) -> np.ndarray:
    """A wide, cheap mean around each pixel: halved ``levels`` times, averaged ``times`` times, expanded.
    About a Gaussian of the variance (2 (4^levels - 1) / 3 + 4^levels times) pixels².
    """
    smaller = gaussian_pyramid(image, levels + 1)
    result = average(smaller[-1], times)
    for target in reversed(smaller[:-1]):
        result = expand(result, *target.shape[:2])
    return result


def gaussian_pyramid(image: np.ndarray, count: int, least_side: int = 0) -> list[np.ndarray]:
    """Levels of the Gaussian pyramid, ``image`` first: at most ``count``. It ends below ``least_side`` pixels."""
    result = [image]
    while len(result) < count and min(result[-1].shape[:2]) >= least_side:
        result.append(reduce(result[-1]))
    return result


def bands(image: np.ndarray, most: int, least_side: int) -> list[np.ndarray]:
    """The Laplacian pyramid of ``image``, finest first: each level of :func:`gaussian_pyramid` less the next coarser
    one. :func:`whole` is the opposite.
    """
    scales = gaussian_pyramid(image, most, least_side)
    return [fine - expand(coarse, *fine.shape[:2]) for fine, coarse in itertools.pairwise(scales)] + scales[-1:]


def whole(bands: list[np.ndarray]) -> np.ndarray:
    """The image with these :func:`bands`."""
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
