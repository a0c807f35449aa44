"""A denoised image and the samples it came from, mixed by what two independent halves say of the errors of both.

Let A and B be images of the same scene from different samples, and a and b what a denoiser makes of each alone. Then,
for any window of pixels, these have the right expected values, whatever the denoiser does (cf. Rousselle et al. 2012):

    (A - B)² / 4            the variance of the raw image (A + B) / 2,
    (a - b)² / 4            that of the denoised image (a + b) / 2,
    (A - a)(B - b)          the square of its bias: what both halves agree in that the denoiser took away is no noise.

The image is the denoised one and a part of what was taken away, which is greater the more of it is no noise: at each
scale by itself, as in Wiener's filter. So light that the denoiser has lost in small spots comes back as the wide, faint
difference that many pixels together are sure of.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .pyramid import average, expand, reduce

#: Scales, each twice as coarse as the one before; and the least side of an image that has a coarser one.
SCALES, LEAST_SIDE = 6, 8

#: How wide the window is that errors are averaged over, see :func:`.pyramid.average`, in pixels of the scale.
WINDOW = 8

#: The part of what was taken away that is no noise is raised to this power, as it is uncertain itself: in doubt, the
#: samples.
CAUTION = 0.8


@dataclass(frozen=True)
class Mixture:
    """Arrays of 32 bits."""

    #: Shape (height, width, channels).
    image: np.ndarray
    #: Squares of the standard error of ``image``, of the raw and of the denoised one, shape (height, width): means over
    #: the channels and the window.
    error: np.ndarray
    raw_error: np.ndarray
    denoised_error: np.ndarray


def mix(first: np.ndarray, second: np.ndarray, denoised_first: np.ndarray, denoised_second: np.ndarray) -> Mixture:
    """The image of least expected error between (first + second) / 2 and (denoised_first + denoised_second) / 2.

    All arrays have the shape (height, width, channels) and finite values; the halves are independent of each other.
    """
    denoised = (denoised_first + denoised_second) / 2
    # An error counts by how much it changes the displayed value, whose slope is that of a square root.
    slope = 1 / (average(np.maximum(denoised, 0).mean(2)) + 0.01)
    removed_first, removed_second = first - denoised_first, second - denoised_second
    bands = removed_first, removed_second, denoised_first - denoised_second
    kept, ours, all_noise = _kept(bands, slope)

    def mean(product: np.ndarray) -> np.ndarray:
        return average(product.mean(2) * slope, WINDOW) / slope

    raw_error = mean(((first - second) / 2) ** 2)
    variance = mean(((denoised_first - denoised_second) / 2) ** 2)
    bias = np.maximum(mean(removed_first * removed_second), 0)
    left = np.divide(ours, all_noise, out=np.zeros_like(ours), where=all_noise > 0)
    return Mixture(denoised + kept, raw_error * left, raw_error, variance + bias)


def _kept(
    bands: tuple[np.ndarray, ...], slope: np.ndarray, scale: int = 1
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``(kept, error, noise)``: the part of what was removed that is put back; and sums over the scales, this one and
    those coarser, of the squared errors of the result and of the raw image. ``bands``: what was removed from either
    half, and the difference of the denoised ones.
    """
    height, width = slope.shape
    coarser = None
    if scale < SCALES and min(height, width) >= LEAST_SIDE:
        lower = tuple(reduce(band) for band in bands)
        coarser = [expand(found, height, width) for found in _kept(lower, reduce(slope), scale + 1)]
        bands = tuple(band - expand(low, height, width) for band, low in zip(bands, lower))
    r, s, d = bands

    def mean(product: np.ndarray) -> np.ndarray:
        return average(product.mean(2) * slope, WINDOW)

    # The least squares of raw - (1 - part) removed: d is what the denoised halves owe to the samples of the pixel.
    noise, shared = mean((r - s + d) ** 2) / 4, mean((r - s + d) * d) / 4
    whole, signal = mean((r + s) ** 2), mean(4 * r * s - d * (r - s))
    part = np.clip(np.divide(signal, whole, out=np.ones_like(whole), where=whole > 0), 0, 1)
    if coarser is None:
        part = np.ones_like(part)  # the light of the whole is that of the samples
    error = part * noise + (1 - part) * np.clip(shared, 0, noise)
    kept = (part**CAUTION)[..., None] * (r + s) / 2
    if coarser is None:
        return kept, error, noise
    return kept + coarser[0], error + coarser[1], noise + coarser[2]
