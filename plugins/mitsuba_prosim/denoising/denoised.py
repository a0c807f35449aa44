"""What is known of an image after it was denoised; the function that finds it."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from ..engine.accumulators import BRIGHTEST
from .mixing import displayed, inputs, mix
from .oidn import Denoiser


@dataclass(frozen=True)
class Denoised:
    """Images of shape (height, width, channels) and maps of shape (height, width), of 32 bits."""

    #: The mean of the two halves; what the denoiser makes of it; and the mixture of both.
    raw: np.ndarray
    denoised: np.ndarray
    final: np.ndarray
    #: Estimated standard error of each pixel of these three, a root mean square over the colours and the pixels around.
    raw_error: np.ndarray
    denoised_error: np.ndarray
    final_error: np.ndarray

    def noise(self, error: np.ndarray) -> float:
        """Root mean square over the pixels of the error of the displayed value, white being 1, by one of the maps.

        About what :class:`~mitsuba_prosim.engine.error_target.ErrorTarget` means by noise, and more where the
        errors of a window are those of a few pixels.
        """
        light = displayed(self.final)
        return float(np.sqrt(np.mean((np.sqrt(light + error) - np.sqrt(light)) ** 2, dtype=np.float64)))

    def errors(self) -> tuple[float, float, float]:
        """RMS error of the displayed final image (white = 1), and the bounds of 99 and of 99.9 % of its pixels, with
        normal errors in each.
        """
        light = displayed(self.final)
        deviation = (np.sqrt(light + self.final_error) - np.sqrt(light)).ravel()
        deviation = deviation[:: max(1, deviation.size // 16384)]
        normal = NormalDist()
        errors = np.outer(deviation, [normal.inv_cdf(0.5 + (k + 0.5) / 128) for k in range(64)]).ravel()
        tails = np.percentile(errors, [99, 99.9])
        return self.noise(self.final_error), float(tails[0]), float(tails[1])


def denoise(
    first: np.ndarray,
    second: np.ndarray,
    albedo: np.ndarray | None = None,
    normal: np.ndarray | None = None,
    fast: bool = False,
) -> Denoised:
    """The image that two halves of its samples give: denoised as far as it gets nearer to the truth by that.

    ``first``, ``second``
        Linear images of the same scene from different samples (other seeds), as many for each: arrays of shape
        (height, width, channels), channels being 1 or 3, or two-dimensional. What is not finite in one is taken from
        the other; what is in neither is black.
    ``albedo``, ``normal``
        What :ref:`integrator-prosim_features` renders, from samples of their own: shape (height, width, 3), or None.
    ``fast``
        With smaller networks, several times as fast, for a first look.

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


def mixed(first: np.ndarray, second: np.ndarray, denoiser: Denoiser) -> Denoised:
    """As :func:`denoise`, for arrays of shape (height, width, 1 or 3), by a ``denoiser`` with the features."""
    first, second = (np.where(np.isfinite(a), a, b) for a, b in ((first, second), (second, first)))
    # Squares are taken of them.
    first, second = (
        np.clip(np.nan_to_num(half, posinf=0, neginf=0), -BRIGHTEST, BRIGHTEST) for half in (first, second)
    )
    mixture = mix(first, second, *(denoiser(image) for image in inputs(first, second)))
    errors = (np.sqrt(e) for e in (mixture.raw_error, mixture.denoised_error, mixture.error))
    return Denoised((first + second) / 2, mixture.denoised, mixture.image, *errors)
