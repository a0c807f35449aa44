"""A denoised image with its layers, as a bitmap or in a film."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import mitsuba as mi
import numpy as np

from .halves import FinalImage


def bitmap(final: FinalImage) -> mi.Bitmap:
    """A bitmap of the :func:`channels`."""
    return of_channels(channels(final, final.names[: final.denoised().final.shape[2]]))


def channels(final: FinalImage, colours: Sequence[str]) -> dict[str, np.ndarray]:
    """The final image, the integrator's own channels, the layers ``raw`` and ``denoised``, and the errors of the three
    images: ``error``, ``error_raw`` and ``error_denoised``, with one channel, ``Y``; each of shape (height, width).
    """
    denoised = final.denoised()
    errors = {"": denoised.final_error, "_raw": denoised.raw_error, "_denoised": denoised.denoised_error}
    result = planes("", denoised.final, colours) | final.others()
    result |= planes("raw.", denoised.raw, colours) | planes("denoised.", denoised.denoised, colours)
    return result | {f"error{name}.Y": error for name, error in errors.items()}


def update_film(final: FinalImage, names: Sequence[str]) -> None:
    """Writes the final image to the film. ``names``: the channels to store after the colours, from
    :func:`channels`. Raises ValueError if the film's colours are not R, G, B or Y.
    """
    film = final.sensor.film()
    if final.names[0] not in ("R", "Y"):
        raise ValueError(
            f"{film.class_name()}: its colours are {', '.join(final.names[:3])}; take pixel_format rgb, rgba, "
            "luminance or luminance_alpha to denoise"
        )
    planes = channels(final, "RGB")
    planes["W"] = np.ones(planes["R"].shape)
    alpha = ["A"] * bool(mi.has_flag(film.flags(), mi.FilmFlags.Alpha))
    values = np.stack([planes[name] for name in (*"RGB", *alpha, "W", *names)], axis=2, dtype=np.float32)
    film.prepare(names)
    film.clear()
    film.put_block(mi.ImageBlock(mi.TensorXf(values), mi.ScalarPoint2i(film.crop_offset()), border=False))


def mixed(
    layers: Mapping[str, np.ndarray], factors: Iterable[tuple[str, np.ndarray]]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The sum of ``layers``, shape (height, width, 3), each multiplied by the ``factors`` of its name, one or three,
    and those layers. Raises KeyError where there is no layer of this name.
    """
    result = dict(layers)
    for name, factor in factors:
        result[name] = result[name] * factor
    return np.sum(list(result.values()), axis=0), result


def planes(prefix: str, image: np.ndarray, colours: Sequence[str] = "RGB") -> dict[str, np.ndarray]:
    """The channels of ``image``, shape (height, width, 1 or 3), by name: ``prefix`` and that of the colour. Films store
    three colours, even if they develop one.
    """
    return {prefix + name: image[..., k % image.shape[2]] for k, name in enumerate(colours)}


def of_channels(planes: dict[str, np.ndarray]) -> mi.Bitmap:
    """A bitmap of named channels, each of shape (height, width)."""
    values = np.stack(list(planes.values()), axis=2, dtype=np.float32)
    return mi.Bitmap(values, mi.Bitmap.PixelFormat.MultiChannel, list(planes))
