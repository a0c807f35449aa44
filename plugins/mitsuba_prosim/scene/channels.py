"""Channels of an image as planes: name of a channel -> array of shape (height, width)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import mitsuba as mi
import numpy as np

from ..engine.accumulators import BRIGHTEST


def parse_factor(text: str) -> tuple[str, np.ndarray]:
    """Returns the name of a layer and its factor from a text such as ``lamp1=0.5`` or ``lamp1=1,0.8,0.6`` (red, green,
    blue), for :func:`mixed`.

    Raises ValueError if the text has another form, or if a number of the factor is negative or above
    :data:`.BRIGHTEST`.
    """
    name, _, values = text.partition("=")
    factor = np.array(values.split(","), dtype=np.float64)
    if len(factor) not in (1, 3) or not ((factor >= 0) & (factor <= BRIGHTEST)).all():
        raise ValueError(f"give one number or three numbers, from 0 to {BRIGHTEST:g}")
    return name, factor.astype(np.float32)


def mixed(
    layers: Mapping[str, np.ndarray], factors: Iterable[tuple[str, np.ndarray]]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Multiplies ``layers`` by ``factors``, and returns ``(sum, layers)``: the sum of all layers after the
    multiplication, and these layers.

    Each layer has the shape (height, width, 3). ``factors`` are pairs (name of a layer, factor); a factor has one
    number, or three numbers for red, green and blue. Raises KeyError if ``factors`` contains a name that no layer has.
    """
    result = dict(layers)
    for name, factor in factors:
        result[name] = result[name] * factor
    return np.sum(list(result.values()), axis=0), result


def planes(prefix: str, image: np.ndarray, colours: Sequence[str] = "RGB") -> dict[str, np.ndarray]:
    """Returns the channels of ``image``, shape (height, width, 1 or 3), as a dictionary: name -> array of shape
    (height, width).

    The name of a channel is ``prefix`` plus the name of the colour, such as ``raw.R``. If ``image`` has only one
    channel, each of the ``colours`` gets the values of this channel, because films store three colours.
    """
    return {prefix + name: image[..., k % image.shape[2]] for k, name in enumerate(colours)}


def of_channels(planes: dict[str, np.ndarray]) -> mi.Bitmap:
    """Returns a bitmap with the channels ``planes``: name of a channel -> array of shape (height, width)."""
    values = np.stack(list(planes.values()), axis=2, dtype=np.float32)
    return mi.Bitmap(values, mi.Bitmap.PixelFormat.MultiChannel, list(planes))
