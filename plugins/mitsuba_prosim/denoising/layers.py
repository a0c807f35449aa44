"""Stores the final image of the denoiser and its layers (raw image, denoised image, errors) in a bitmap or a film."""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi
import numpy as np

from ..engine.film import put
from ..scene.channels import of_channels, planes
from .final_image import FinalImage


def bitmap(final: FinalImage) -> mi.Bitmap:
    """Returns a bitmap with the final image and all its layers, see :func:`channels`."""
    return of_channels(channels(final, final.denoiser.names[: final.denoised().final.shape[2]]))


def channels(final: FinalImage, colours: Sequence[str]) -> dict[str, np.ndarray]:
    """Returns the channels of the final image and of all layers: name -> array of shape (height, width).

    They are the colours of the final image, alpha and AOVs, the layers ``raw`` and ``denoised``, and the errors
    ``error.Y``, ``error_raw.Y`` and ``error_denoised.Y``. ``colours`` are names such as "RGB"; the three colours of a
    grey image are equal.
    """
    denoised = final.denoised()
    errors = {"": denoised.final_error, "_raw": denoised.raw_error, "_denoised": denoised.denoised_error}
    result = planes("", denoised.final, colours) | final.other_channels()
    result |= planes("raw.", denoised.raw, colours) | planes("denoised.", denoised.denoised, colours)
    return result | {f"error{name}.Y": error for name, error in errors.items()}


def update_film(final: FinalImage, names: Sequence[str]) -> None:
    """Writes the final image and the :func:`channels` with these ``names`` to the film of the sensor. Raises ValueError
    if the film stores neither RGB colours nor the luminance.
    """
    film = final.denoiser.sensor.film()
    if final.denoiser.names[0] not in ("R", "Y"):
        raise ValueError(
            f"{film.class_name()}: its colours are {', '.join(final.denoiser.names[:3])}; take pixel_format rgb, rgba, "
            "luminance or luminance_alpha to denoise"
        )
    planes = channels(final, "RGB")
    planes["W"] = np.ones(planes["R"].shape)  # the film divides by this weight
    alpha = ["A"] * bool(mi.has_flag(film.flags(), mi.FilmFlags.Alpha))
    values = np.stack([planes[name] for name in (*"RGB", *alpha, "W", *names)], axis=2, dtype=np.float32)
    put(film, mi.TensorXf(values), names)
