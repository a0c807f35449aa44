"""Denoises an image and estimates its error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from ..engine.accumulators import BRIGHTEST
from .mixing import displayed, in_display, inputs, mix
from .oidn import Denoiser

NORMAL = NormalDist()


@dataclass(frozen=True)
class Denoised:
    """Images of shape (height, width, channels) and maps of shape (height, width), of 32 bits."""

    #: The mean of the two halves; the output of the denoiser; and the mixture of both.
    raw: np.ndarray
    denoised: np.ndarray
    final: np.ndarray
    #: Estimated standard error of each pixel of these three: RMS over the colours and the neighbourhood.
    raw_error: np.ndarray
    denoised_error: np.ndarray
    final_error: np.ndarray
    #: Squared errors of the displayed luminance (white = 1) of ``raw`` and ``final``, shape (height, width), 64 bits.
    #: Their means over many pixels are about unbiased; single values are uncertain, and may be negative.
    raw_squares: np.ndarray
    final_squares: np.ndarray

    @property
    def raw_noise(self) -> float:
        """Estimated RMS error of the displayed raw image (white = 1)."""
        return float(self.raw_squares.mean()) ** 0.5

    @property
    def noise(self) -> float:
        """Estimated RMS error of the displayed final image (white = 1)."""
        return max(float(self.final_squares.mean()), 0.0) ** 0.5

    @property
    def at_most(self) -> float:
        """RMS error that the displayed final image exceeds with a probability of 5 %, about."""
        deviation = float(np.sqrt(np.sum(self.final_squares**2))) / self.final_squares.size
        return max(float(self.final_squares.mean()) + NORMAL.inv_cdf(0.95) * deviation, 0.0) ** 0.5

    def errors(self) -> tuple[float, float, float]:
        """``noise``, and bounds of the errors of 99 and of 99.9 % of the displayed pixels: normal errors in each, in
        proportion to the error map.
        """
        light = displayed(self.final)
        deviation = (np.sqrt(light + self.final_error) - np.sqrt(light)).ravel()
        deviation = deviation[:: max(1, deviation.size // 16384)]
        errors = np.outer(deviation, [NORMAL.inv_cdf(0.5 + (k + 0.5) / 128) for k in range(64)]).ravel()
        tails = np.percentile(errors, [99, 99.9]) * (self.noise / max(float(np.sqrt(np.mean(deviation**2))), 1e-30))
        return self.noise, float(tails[0]), float(tails[1])


def denoise(
    first: np.ndarray,
    second: np.ndarray,
    albedo: np.ndarray | None = None,
    normal: np.ndarray | None = None,
    fast: bool = False,
) -> Denoised:
    """Denoises an image of two halves, as far as that reduces its error.

    ``first``, ``second``
        Linear images of the same scene from equally many different samples (other seeds): shape (height, width,
        channels) with 1 or 3 channels, or (height, width). A value that is not finite is taken from the other half, and
        is black if it is finite in neither.
    ``albedo``, ``normal``
        Images of :ref:`integrator-prosim_features` from independent samples: shape (height, width, 3), or None.
    ``fast``
        Smaller networks, several times as fast.

    Returns a :class:`Denoised`. Raises ValueError where the shapes do not fit, and :class:`.oidn.MissingError` where
    the package mitsuba-oidn is not installed.
    """
    first, second = (np.array(half, dtype=np.float32, ndmin=2) for half in (first, second))
    if first.ndim == 2 == second.ndim:
        first, second = first[..., None], second[..., None]
    if first.shape != second.shape or first.ndim != 3 or first.shape[2] not in (1, 3) or not first.size:
        raise ValueError(
            f"denoise: halves of the shapes {first.shape} and {second.shape}; both must be (height, width, 3) or "
            "(height, width, 1), and hold colours alone: give the other channels separately"
        )
    for name, feature in (("albedo", albedo), ("normal", normal)):
        if feature is not None and np.shape(feature) != (*first.shape[:2], 3):
            raise ValueError(f"denoise: {name} has the shape {np.shape(feature)}, not {(*first.shape[:2], 3)}")
    return mixed(first, second, Denoiser(albedo, normal, fast))


def mixed(first: np.ndarray, second: np.ndarray, denoiser: Callable[[np.ndarray], np.ndarray]) -> Denoised:
    """As :func:`denoise`, for arrays of shape (height, width, 1 or 3), by a ``denoiser`` with the features."""
    first, second = (np.where(np.isfinite(a), a, b) for a, b in ((first, second), (second, first)))
    # Their squares must be finite.
    first, second = (
        np.clip(np.nan_to_num(half, posinf=0, neginf=0), -BRIGHTEST, BRIGHTEST) for half in (first, second)
    )
    mixture = mix(first, second, *(denoiser(image) for image in inputs(first, second)))
    raw, denoised, final = (np.sqrt(e) for e in (mixture.raw_error, mixture.denoised_error, mixture.error))
    raw_squares = np.square((in_display(first) - in_display(second)) / 2)
    images = (first + second) / 2, mixture.denoised, mixture.image
    return Denoised(*images, raw, denoised, final, raw_squares, mixture.squares)
