"""A denoised image with its layers, as a bitmap or in a film."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import mitsuba as mi
import numpy as np

from .halves import Halves
from .mixing import Denoised


def bitmap(halves: Halves, denoised: Denoised) -> mi.Bitmap:
    """The final image, the integrator's own channels, the layers ``raw`` and ``denoised``, and the errors of the three
    images: ``error``, ``error_raw`` and ``error_denoised``, with one channel, ``Y``.
    """
    colours = halves.names[: denoised.final.shape[2]]
    planes = dict(zip(colours, np.moveaxis(denoised.final, 2, 0))) | halves.others()
    for layer, image in (("raw", denoised.raw), ("denoised", denoised.denoised)):
        planes |= {f"{layer}.{name}": plane for name, plane in zip(colours, np.moveaxis(image, 2, 0))}
    planes |= errors(denoised)
    return of_channels(planes)


def update_film(halves: Halves, denoised: Denoised, film: mi.Film, names: Sequence[str]) -> None:
    """Puts the final image into ``film``, with the channels ``names``: the integrator's own, and the layers of
    :func:`bitmap`. Raises ValueError where the film's colours are not R, G, B or Y.
    """
    if halves.names[0] not in ("R", "Y"):
        raise ValueError(
            f"{film.class_name()}: its colours are {', '.join(halves.names[:3])}; take pixel_format rgb, rgba, "
            "luminance or luminance_alpha to denoise"
        )
    planes = halves.others() | {"W": np.ones(denoised.raw_error.shape)}
    for layer, image in (("", denoised.final), ("raw.", denoised.raw), ("denoised.", denoised.denoised)):
        # Films store three colours, even if they develop one.
        planes |= {f"{layer}{c}": image[..., k % image.shape[2]] for k, c in enumerate("RGB")}
    planes |= errors(denoised)
    alpha = ["A"] * bool(mi.has_flag(film.flags(), mi.FilmFlags.Alpha))
    values = np.stack([planes[name] for name in (*"RGB", *alpha, "W", *names)], axis=2, dtype=np.float32)
    film.prepare(names)
    film.clear()
    film.put_block(mi.ImageBlock(mi.TensorXf(values), mi.ScalarPoint2i(film.crop_offset()), border=False))


def errors(denoised: Denoised) -> dict[str, np.ndarray]:
    """The error maps as layers."""
    return {
        "error.Y": denoised.final_error,
        "error_raw.Y": denoised.raw_error,
        "error_denoised.Y": denoised.denoised_error,
    }


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


def of_channels(planes: dict[str, np.ndarray]) -> mi.Bitmap:
    """A bitmap of named channels, each of shape (height, width)."""
    values = np.stack(list(planes.values()), axis=2, dtype=np.float32)
    return mi.Bitmap(values, mi.Bitmap.PixelFormat.MultiChannel, list(planes))
