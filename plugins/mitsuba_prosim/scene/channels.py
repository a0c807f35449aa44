"""Channels of an image as planes: name of a channel -> array of shape (height, width)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import mitsuba as mi
import numpy as np

from ..engine.accumulators import BRIGHTEST


def parse_factor(text: str) -> tuple[str, np.ndarray]:
    """Returns the name of a layer and its factor, for :func:`mixed`, from a text such as ``lamp1=0.5`` or
    ``lamp1=1,0.8,0.6`` (red, green, blue).

    Raises ValueError for another form, and for a number that is negative or above :data:`.BRIGHTEST`.
    """
    name, _, values = text.partition("=")
    factor = np.array(values.split(","), dtype=np.float64)
    if len(factor) not in (1, 3) or not ((factor >= 0) & (factor <= BRIGHTEST)).all():
        raise ValueError(f"give one number or three numbers, from 0 to {BRIGHTEST:g}")
    return name, factor.astype(np.float32)


def mixed(
    layers: Mapping[str, np.ndarray], factors: Iterable[tuple[str, np.ndarray]]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Multiplies ``layers``, each of shape (height, width, 3), by ``factors``; returns their sum, and the layers.

    ``factors`` are pairs of a layer's name and one number, or three for red, green and blue. Raises KeyError for a name
    that no layer has.
    """
    result = dict(layers)
    for name, factor in factors:
        result[name] = result[name] * factor
    return np.sum(list(result.values()), axis=0), result


def planes(prefix: str, image: np.ndarray, colours: Sequence[str] = "RGB") -> dict[str, np.ndarray]:
    """Returns the channels of ``image``, shape (height, width, 1 or 3): name, such as ``raw.R`` -> array.

    Films store three colours, so each of the ``colours`` of a grey image has its values.
    """
    return {prefix + name: image[..., k % image.shape[2]] for k, name in enumerate(colours)}


def of_channels(planes: dict[str, np.ndarray]) -> mi.Bitmap:
    """Returns a bitmap with the channels ``planes``: name of a channel -> array of shape (height, width)."""
    values = np.stack(list(planes.values()), axis=2, dtype=np.float32)
    return mi.Bitmap(values, mi.Bitmap.PixelFormat.MultiChannel, list(planes))
