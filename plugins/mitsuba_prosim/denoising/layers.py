"""A denoised image with its layers (raw image, denoised image, errors), as a bitmap or in a film."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import mitsuba as mi
import numpy as np

from ..engine.accumulators import BRIGHTEST
from ..engine.film import put
from .halves import FinalImage


def bitmap(final: FinalImage) -> mi.Bitmap:
    """Returns a bitmap with all :func:`channels` of the denoised image."""
    return of_channels(channels(final, final.names[: final.denoised().final.shape[2]]))


def channels(final: FinalImage, colours: Sequence[str]) -> dict[str, np.ndarray]:
    """Returns the channels of the final image and of all layers: name -> array of shape (height, width).

    The channels are the colours of the final image, the integrator's own channels, the layers ``raw`` and ``denoised``,
    and the errors of the final, the raw and the denoised image. The errors are ``error.Y``, ``error_raw.Y`` and
    ``error_denoised.Y``.
    """
    denoised = final.denoised()
    errors = {"": denoised.final_error, "_raw": denoised.raw_error, "_denoised": denoised.denoised_error}
    result = planes("", denoised.final, colours) | final.other_channels()
    result |= planes("raw.", denoised.raw, colours) | planes("denoised.", denoised.denoised, colours)
    return result | {f"error{name}.Y": error for name, error in errors.items()}


def update_film(final: FinalImage, names: Sequence[str]) -> None:
    """Writes the final image to the film.

    ``names`` are the :func:`channels` to store after the colours. Raises ValueError if the film's colours are not R, G,
    B or Y.
    """
    film = final.sensor.film()
    if final.names[0] not in ("R", "Y"):
        raise ValueError(
            f"{film.class_name()}: its colours are {', '.join(final.names[:3])}; take pixel_format rgb, rgba, "
            "luminance or luminance_alpha to denoise"
        )
    planes = channels(final, "RGB")
    planes["W"] = np.ones(planes["R"].shape)  # the film divides by this weight
    alpha = ["A"] * bool(mi.has_flag(film.flags(), mi.FilmFlags.Alpha))
    values = np.stack([planes[name] for name in (*"RGB", *alpha, "W", *names)], axis=2, dtype=np.float32)
    put(film, mi.TensorXf(values), names)


def parse_factor(text: str) -> tuple[str, np.ndarray]:
    """Parses a layer and its factor, for :func:`mixed`: returns ``(name, factor)`` of a text such as ``lamp1=0.5`` or
    ``lamp1=1,0.8,0.6`` (red, green, blue).

    Raises ValueError for a text of another form, and for a factor that is negative or above :data:`.BRIGHTEST`.
    """
    name, _, values = text.partition("=")
    factor = np.array(values.split(","), dtype=np.float64)
    if len(factor) not in (1, 3) or not ((factor >= 0) & (factor <= BRIGHTEST)).all():
        raise ValueError(f"give one number or three numbers, from 0 to {BRIGHTEST:g}")
    return name, factor.astype(np.float32)


def mixed(
    layers: Mapping[str, np.ndarray], factors: Iterable[tuple[str, np.ndarray]]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Multiplies layers by factors, and returns ``(sum, layers)``: the sum of all layers, and the layers.

    Each layer has the shape (height, width, 3). ``factors`` are pairs of the name of a layer and a factor, which has
    one number or three numbers. Raises KeyError if no layer has the name of a factor.
    """
    result = dict(layers)
    for name, factor in factors:
        result[name] = result[name] * factor
    return np.sum(list(result.values()), axis=0), result


def planes(prefix: str, image: np.ndarray, colours: Sequence[str] = "RGB") -> dict[str, np.ndarray]:
    """Returns the channels of ``image``, shape (height, width, 1 or 3): name -> array of shape (height, width).

    A name is ``prefix`` plus the name of the colour. An image of one channel is repeated for each of the ``colours``,
    because films store three colours.
    """
    return {prefix + name: image[..., k % image.shape[2]] for k, name in enumerate(colours)}


def of_channels(planes: dict[str, np.ndarray]) -> mi.Bitmap:
    """Returns a bitmap of named channels, each of shape (height, width)."""
    values = np.stack(list(planes.values()), axis=2, dtype=np.float32)
    return mi.Bitmap(values, mi.Bitmap.PixelFormat.MultiChannel, list(planes))
