"""A denoised image and the samples it came from, mixed by what two independent halves say of the errors of both.

Let A and B be images of the same scene from different samples, M = (A + B) / 2 the raw image, and d = (A - B) / 2,
which is noise of the same size as that of M, and independent of it where it is Gaussian. What is denoised are M + d/2
and M - d/2, each by itself; D is the mean of the two results and e their difference, which says how the denoiser
follows noise like d. Then, for any window of pixels, these have about the right expected values (Stein 1981; exactly
where the denoiser is linear in the noise):

    d²                      the variance of the raw image M,
    d e                     what the denoised image D owes to the noise of M,
    (M - D)² - d² + 2 d e   the squared error of D,
    (M - D)² - d² + d e     (M - D) times what D lacks: what was taken away and is no noise.

The image is D and a part of what was taken away, which is greater the more of it is no noise: at each scale by itself,
as in Wiener's filter. So light that the denoiser has lost in small spots comes back as the wide, faint difference that
many pixels together are sure of. Each part is itself uncertain; how much so is estimated as well, and where it can't be
told from that of a wide neighbourhood, that is taken (James and Stein 1961).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .pyramid import average, bands, blur, halved, whole

#: Scales, each twice as coarse as the one before; and the least side of an image that has a coarser one.
SCALES, LEAST_SIDE = 4, 8

#: The windows that products are averaged over, narrow and wide: how often halved and how often averaged then, see
#: :func:`.pyramid.blur`. About Gaussians of 3 and 26 pixels of the scale.
NARROW, WIDE = (1, 2), (4, 2)

#: How many pixels of equal weight the narrow window is worth.
PIXELS = 4 * np.pi * 10

#: A pixel is sure whose variance is much less than this part of the mean.
SURE = 1 / 30

#: The part of the light that is added at most: more is that of single samples, and would be seen everywhere.
LIGHT = 0.02


@dataclass(frozen=True)
class Mixture:
    """Arrays of 32 bits."""

    #: Shape (height, width, channels): the mixture, and the denoised image.
    image: np.ndarray
    denoised: np.ndarray
    #: Squares of the standard error of ``image``, of the raw and of the denoised one, shape (height, width): means over
    #: the channels and the window, whose sum is that of the pixels.
    error: np.ndarray
    raw_error: np.ndarray
    denoised_error: np.ndarray


def inputs(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What is to be denoised of two halves: three quarters of either and a quarter of the other."""
    quarter = (first - second) / 4
    return first - quarter, second + quarter


def mix(first: np.ndarray, second: np.ndarray, near_first: np.ndarray, near_second: np.ndarray) -> Mixture:
    """The image of least expected error between (first + second) / 2 and (near_first + near_second) / 2, the latter
    being what :func:`inputs` gives, denoised.

    All arrays have the shape (height, width, channels) and finite values; the halves are independent of each other.
    """
    raw, noise = (first + second) / 2, (first - second) / 2
    denoised, followed = (near_first + near_second) / 2, near_first - near_second
    removed = raw - denoised
    light = average(displayed(denoised))
    # An error counts by how much it changes the displayed value, whose slope is that of a square root.
    scales = [bands(image, SCALES, LEAST_SIDE) for image in (removed, noise, noise - followed)]
    slopes = halved(1 / light, len(scales[0]))
    parts = [part(r, d, d - t, s)[..., None] for r, d, t, s in zip(*scales, slopes)]
    image = denoised + whole([share * r for share, r in zip(parts, scales[0])])
    # Beside what is much brighter the scales may not cancel out: no darker than all that there is.
    image = np.maximum(image, np.minimum(np.minimum(raw, denoised), average(raw)))
    left = followed + whole([share * taken for share, taken in zip(parts, scales[2])])
    own = noise * noise
    error = removed * removed - own + 2 * noise * followed
    # Each is at least the variance, which has one sign.
    squares = noise * left, left * left, own, error, followed * followed
    mean = spread(np.stack([x.mean(2) for x in squares], axis=2), displayed(image))
    error, denoised_error = np.maximum(mean[0], mean[1]), np.maximum(mean[3], mean[4])
    return Mixture(with_light(image, raw, error), denoised, error, mean[2], denoised_error)


def displayed(image: np.ndarray) -> np.ndarray:
    """The square of the displayed value of each pixel, shape (height, width)."""
    return np.maximum(image.mean(2), 0) + np.float32(0.01)


def part(removed: np.ndarray, noise: np.ndarray, followed: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """The part of what was removed from a scale that is to be put back, 0 to 1, shape (height, width)."""
    all_removed = (removed * removed).mean(2) * slope
    kept = all_removed + ((followed - noise) * noise).mean(2) * slope
    # By how much ``kept`` may be off: the product of what is left and noise that is independent of it.
    uncertain = (removed * (noise - followed / 2)).mean(2) * slope
    products = np.stack([all_removed, kept, uncertain * uncertain], axis=2)
    all_removed, kept, variance = np.moveaxis(blur(products, *NARROW), 2, 0)
    usual = np.clip(ratio(*np.moveaxis(blur(products[..., 1::-1], *WIDE), 2, 0)), 0, 1)
    more = kept - usual * all_removed
    sure = np.maximum(1 - ratio(4 / PIXELS * variance, more * more), 0)
    return np.clip(usual + sure * ratio(more, all_removed), 0, 1)


def spread(squares: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Squared errors, shape (height, width, n), distributed among the pixels around by their light; shape
    (n, height, width).
    """
    among = blur(light, *NARROW)[..., None]
    return np.moveaxis(light[..., None] * blur(squares / among, *NARROW), 2, 0)


def with_light(image: np.ndarray, raw: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """``image`` with the light of ``raw``: what is missing is added to all pixels alike but those that are sure."""
    found = image.sum((0, 1), dtype=np.float64)
    missing = np.clip(raw.sum((0, 1), dtype=np.float64) - found, -LIGHT * abs(found), LIGHT * abs(found))
    share = variance / np.maximum(variance + SURE * variance.mean(), np.float32(1e-30))
    return image + share[..., None] * (missing / max(share.sum(dtype=np.float64), 1e-30)).astype(np.float32)


def ratio(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a / b, and 1 where b is not above 0."""
    return np.divide(a, b, out=np.ones_like(a), where=b > 0)
