"""Denoises an image and estimates the error of the result."""

from __future__ import annotations

import numpy as np

from ..engine.accumulators import BRIGHTEST
from .denoised import Denoised
from .mixing import inputs, mix
from .oidn import Denoiser

#: Greatest value for which the estimates are computed in 32 bits: they contain fourth powers.
LARGEST = 1e8


def denoise(
    first: np.ndarray,
    second: np.ndarray,
    albedo: np.ndarray | None = None,
    normal: np.ndarray | None = None,
    fast: bool = False,
) -> Denoised:
    """Denoises an image that is given as two images, each from half of the samples, and mixes the denoised image with
    the raw image.

    ``first``, ``second``
        Linear images of the same scene, with equally many samples and different seeds: shape (height, width, channels)
        with 1 or 3 channels, or (height, width). A pixel value that is not finite is replaced by the value of the other
        image, or by 0 if neither image has a finite value.
    ``albedo``, ``normal``
        Images of :ref:`integrator-prosim_features`, from samples that are independent of ``first`` and ``second``:
        shape (height, width, 3), or None. Normals need an albedo.
    ``fast``
        Use smaller neural networks, which are several times faster.

    Returns a :class:`Denoised`. Raises ValueError where the images do not fit, and :class:`.oidn.MissingError` where
    the package mitsuba-oidn is not installed.
    """
    if any(np.asarray(half).dtype.kind in "biu" for half in (first, second)):
        raise ValueError("denoise: the images are integers, but must be linear floats (white = 1); convert them first")
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
    if albedo is None and normal is not None:
        raise ValueError("denoise: Open Image Denoise uses normals only together with an albedo; give it, too")
    return denoise_halves(first, second, Denoiser(albedo, normal, fast))


def denoise_halves(first: np.ndarray, second: np.ndarray, denoiser: Denoiser) -> Denoised:
    """Does the work of :func:`denoise` for images of the shape (height, width, 1 or 3)."""
    first, second = (np.where(np.isfinite(a), a, b) for a, b in ((first, second), (second, first)))
    # Values are clipped so that their squares are finite.
    first, second = (np.nan_to_num(half, posinf=0, neginf=0) for half in (first, second))
    first, second = (np.clip(half, -BRIGHTEST, BRIGHTEST) for half in (first, second))
    images = [first, second, *(denoiser(image) for image in inputs(first, second))]
    if max(float(np.abs(image).max()) for image in images) > LARGEST:
        images = [image.astype(np.float64) for image in images]
    return mix(*images)
