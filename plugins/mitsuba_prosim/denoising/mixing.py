"""Mixes a denoised image with the raw image. The errors of the raw and of the denoised image are estimated from two
images, each from an independent half of the samples.

Let A and B be images of the same scene from different samples, M = (A + B) / 2 the raw image, and d = (A - B) / 2. The
half difference d of the images A and B contains only noise, which has the same variance as the noise of their mean M.
If the noise of A and B is Gaussian, the half difference d is independent of the noise of the mean M. The denoiser is
applied separately to M + d/2 and M - d/2, the raw image M plus and minus half of the noise d. The denoised image D is
the mean of the denoiser's two results, and e is the difference of the two results: the denoiser's response to the noise
d. As means over any window of pixels, the following estimators are about unbiased (Stein 1981; exactly unbiased if the
denoiser is linear in the noise):

    d²                      the variance of the raw image M,
    d e                     the covariance of D and M,
    (M - D)² - d² + 2 d e   the squared error of D,
    (M - D)² - d² + d e     (M - D) times the signal that D lacks.

At each scale of an image pyramid, a share (0 to 1) of M - D, the raw image minus the denoised image, is added to the
denoised image D. As in Wiener's filter, the share of M - D that is added is the estimated fraction of M - D (raw minus
denoised image) that is signal, not noise. If the denoiser has removed the light of small spots, the coarse scales add
this light again as a wide, faint correction, because only many pixels together show that light is missing. The share of
M - D that is added at a pixel is uncertain, so the variance of the share is estimated, too. The less significantly the
share at a pixel differs from the share in a wide neighbourhood of the pixel, the more the share at the pixel is moved
towards the share in the neighbourhood (James and Stein 1961).

Let f be the tone curve (:func:`display_value`), and F the mixture. The squared error of the displayed mixture f(F) is
estimated by (f(F) - f(A)) (f(F) - f(B)) plus twice the product of the displayed noise and the response of f(F) to this
noise. The response of the mixture to noise includes the change of the shares that the noise causes. The mean of the
estimated squared errors over the whole image is a nearly unbiased estimate of the mean squared error of the displayed
mixture.
"""

from __future__ import annotations

import numpy as np

from .denoised import Denoised
from .pyramid import average, bands, blur, from_bands, gaussian_pyramid

#: Number of scales, each twice as coarse as the previous scale; and the minimum side of an image that has a coarser
#: scale.
SCALES, LEAST_SIDE = 4, 8

#: Windows for averages of products, as arguments of :func:`.pyramid.blur`: about Gaussians with standard deviations of
#: 3 and 26 pixels.
NARROW, WIDE = (1, 2), (4, 2)

#: Effective number of pixels of the narrow window.
PIXELS = 4 * np.pi * 10

#: A pixel is converged if its variance is much less than this fraction of the mean variance.
SURE = 1 / 30

#: Step of the numerical derivative of the mixture, in units of the noise d.
STEP = np.float32(0.1)

#: Weights of the luminance of linear sRGB, as in Mitsuba.
LUMINANCE = np.array([0.212671, 0.715160, 0.072169], np.float32)

#: Maximum fraction of light that is added. A greater difference would come from single samples, and its addition would
#: be visible everywhere.
LIGHT = 0.02


def inputs(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the two images to which the denoiser is applied.

    Each of the returned images is three quarters of ``first`` or ``second`` plus one quarter of the other image. The
    returned images are M + d/2 and M - d/2, where M is the mean of ``first`` and ``second``, and d is half their
    difference.
    """
    quarter = (first - second) / 4
    return first - quarter, second + quarter


def mix(first: np.ndarray, second: np.ndarray, near_first: np.ndarray, near_second: np.ndarray) -> Denoised:
    """Returns a :class:`Denoised` whose final image is the mixture of the raw image (first + second) / 2 and the
    denoised image (near_first + near_second) / 2 that has the least expected error. Finally, :func:`with_light`
    corrects the sum of each colour channel of the mixture.

    ``near_first`` and ``near_second`` are the denoiser's results for the two images that :func:`inputs` returns. All
    four arguments have the same shape (height, width, channels), and only finite values. The images ``first`` and
    ``second`` are from independent halves of the samples.
    """
    # In the notation of this module: M, d, D and e.
    raw, noise = (first + second) / 2, (first - second) / 2
    denoised, followed = (near_first + near_second) / 2, near_first - near_second
    # Squared errors are weighted by the squared slope of the tone curve, a square root (up to a constant factor).
    weight = 1 / average(displayed_squared(denoised))
    # ``left`` is the noise that is left in the mixture: its response to d with constant shares.
    image, left = combined(raw, denoised, noise, followed, weight)
    # The mixture is computed again after the noise d was added to the samples, because the shares depend on the noise.
    above = combined(raw + STEP * noise, denoised + STEP * followed, noise, followed, weight)[0]
    response = (above - image) / (2 * STEP)
    removed = raw - denoised
    own = noise * noise
    error = removed * removed - own + 2 * noise * followed
    # The products are: squared error and variance of the mixture, variance of the raw image, squared error and variance
    # of the denoised image. For the best shares, the squared error of the mixture is its covariance with the raw image.
    # An estimated squared error may be negative, so the variance, which is positive, is its lower bound.
    products = noise * left, left * left, own, error, followed * followed
    mean = spread(np.stack([x.mean(2) for x in products], axis=2), displayed_squared(image))
    final_error, denoised_error = np.maximum(mean[0], mean[1]), np.maximum(mean[3], mean[4])
    image = with_light(image, raw, final_error)
    errors = np.sqrt(mean[2]), np.sqrt(denoised_error), np.sqrt(final_error)
    return Denoised(raw, denoised, image, *errors, *squares(image, first, second, response))


def unmixed(raw: np.ndarray, error: np.ndarray, noise: float) -> Denoised:
    """Returns a :class:`Denoised` whose raw, denoised and final image are all the image ``raw``, because the denoiser
    is not needed.

    ``error``, shape (height, width), is proportional to the standard error of each pixel's luminance; values that are
    not finite count as 0. This function multiplies ``error`` by a constant factor, so that the RMS error of the
    displayed image (white = 1) is ``noise``.
    """
    error = np.nan_to_num(error, posinf=0)
    squares = np.square(error / (2 * display_value(raw)))  # the slope of the tone curve is 1 / (2 display_value)
    factor = noise / max(squares.mean(), 1e-60) ** 0.5
    error, squares = error * np.float32(factor), squares * factor**2
    return Denoised(raw, raw, raw, error, error, error, squares, squares)


def combined(
    raw: np.ndarray, denoised: np.ndarray, noise: np.ndarray, followed: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Returns ``(mixture, response)``.

    ``mixture`` is the mixture of the images ``raw`` and ``denoised``; the mixture is nowhere darker than the darkest of
    the raw, the denoised and the smoothed raw image. ``response`` is the change of the mixture if ``noise`` is added to
    the raw image and the shares of the mixture stay constant. ``followed`` is the change of the denoised image if
    ``noise`` is added to the raw image. ``weight``, shape (height, width), is the factor by which the squared error of
    each pixel is multiplied, because the mixture minimises a weighted error.
    """
    scales = [bands(image, SCALES, LEAST_SIDE) for image in (raw - denoised, noise, noise - followed)]
    # At each scale: r is M - D, d the noise, t the noise that the denoiser takes away (so e = d - t), w the weight.
    parts = [shares(r, d, d - t, w)[..., None] for r, d, t, w in zip(*scales, gaussian_pyramid(weight, len(scales[0])))]
    image = denoised + from_bands([share * r for share, r in zip(parts, scales[0])])
    # Around a very bright pixel, scales with different shares do not cancel, and pixels could become too dark. So the
    # result is nowhere darker than the darkest of the raw image, the denoised image and the smoothed raw image.
    image = np.maximum(image, np.minimum(np.minimum(raw, denoised), average(raw)))
    return image, followed + from_bands([share * taken for share, taken in zip(parts, scales[2])])


def squares(
    image: np.ndarray, first: np.ndarray, second: np.ndarray, response: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the maps ``raw_squares`` and ``final_squares`` of :class:`Denoised`: the estimated squared errors of the
    displayed raw image and of the displayed final image.

    ``image`` is the final image. ``response`` is half the change of ``image`` if the noise d = (first - second) / 2 is
    added to the raw image. The docstring of this module explains the estimator of ``final_squares``.
    """
    final, a, b, above, below = (display_value(x) for x in (image, first, second, image + response, image - response))
    # a - b is twice the displayed noise, and above - below is the response of the displayed mixture to the noise d.
    return np.square((a - b) / 2), (final - a) * (final - b) + (a - b) * (above - below)


def display_value(image: np.ndarray) -> np.ndarray:
    """Returns the displayed luminance of a linear image, shape (height, width), by the tone curve of
    :func:`~mitsuba_prosim.engine.standard_error.displayed`.
    """
    luminance = image @ LUMINANCE if image.shape[2] == 3 else image[..., 0]
    return np.sqrt(np.maximum(luminance, 0, dtype=np.float64) + 0.01)


def displayed_squared(image: np.ndarray) -> np.ndarray:
    """Approximates :func:`display_value` squared, by the channels' mean, of which the errors are as well."""
    return np.maximum(image.mean(2), 0) + np.float32(0.01)


def shares(removed: np.ndarray, noise: np.ndarray, followed: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Returns, for one scale, the share (0 to 1) of M - D, the raw image minus the denoised image, that is added to the
    denoised image D; shape (height, width).

    At this scale, ``removed`` is the raw image minus the denoised image, ``noise`` is the noise d of the raw image, and
    ``followed`` is the denoiser's response to the noise d; shape (height, width, channels). ``weight``, shape (height,
    width), is the factor by which the squared error of each pixel is multiplied, because the mixture minimises a
    weighted error.
    """
    # (M - D)², and its part that is signal; their ratio is the share.
    all_removed = (removed * removed).mean(2) * weight
    kept = all_removed + ((followed - noise) * noise).mean(2) * weight
    # About half the standard deviation of ``kept`` at a pixel. Without ``followed``, ``kept`` is (removed - noise)
    # times (removed + noise), a product of independent noise.
    uncertain = (removed * (noise - followed / 2)).mean(2) * weight
    products = np.stack([all_removed, kept, uncertain * uncertain], axis=2)
    all_removed, kept, variance = np.moveaxis(blur(products, *NARROW), 2, 0)
    wide_share = np.clip(ratio(*np.moveaxis(blur(products[..., 1::-1], *WIDE), 2, 0)), 0, 1)
    difference = kept - wide_share * all_removed
    # The factor of James and Stein. 4 / PIXELS * variance is the variance of the mean of ``kept`` in the narrow window.
    significance = np.maximum(1 - ratio(4 / PIXELS * variance, difference * difference), 0)
    return np.clip(wide_share + significance * ratio(difference, all_removed), 0, 1)


def spread(squares: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Smooths maps of squared errors over the neighbourhood of each pixel; brighter pixels get a greater part of the
    error.

    The squared errors are divided by the mean of ``light`` around them, averaged in the window :data:`NARROW`, and
    multiplied by the ``light`` of the pixel. ``squares`` are n maps of squared errors, shape (height, width, n).
    ``light`` is the brightness of each pixel, which must be positive, shape (height, width). The result has the shape
    (n, height, width).
    """
    light_around = blur(light, *NARROW)[..., None]
    return np.moveaxis(light[..., None] * blur(squares / light_around, *NARROW), 2, 0)


def with_light(image: np.ndarray, raw: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Returns ``image`` after a small change that gives each colour channel the same sum over all pixels as in ``raw``.

    The sum of a channel changes by at most the fraction :data:`LIGHT` of the sum in ``image``. ``variance`` is the
    estimated squared error of each pixel of ``image``, shape (height, width). About the same value is added to each
    pixel, except that almost nothing is added to converged pixels (see :data:`SURE`).
    """
    old_light = image.sum((0, 1), dtype=np.float64)
    missing = np.clip(raw.sum((0, 1), dtype=np.float64) - old_light, -LIGHT * abs(old_light), LIGHT * abs(old_light))
    share = variance / np.maximum(variance + SURE * variance.mean(), np.float32(1e-30))
    return image + share[..., None] * (missing / max(share.sum(dtype=np.float64), 1e-30)).astype(np.float32)


def ratio(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Returns a / b for each element of the arrays; 1 where b is 0 or negative."""
    return np.divide(a, b, out=np.ones_like(a), where=b > 0)
