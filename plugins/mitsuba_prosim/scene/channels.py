"""Channels of an image as planes: name of a channel -> array of shape (height, width)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress

import mitsuba as mi
import numpy as np

from ..engine.accumulators import BRIGHTEST


def parse_factors(texts: Iterable[str], names: Sequence[str]) -> dict[str, np.ndarray]:
    """Returns layer -> factor, for :func:`mixed`, from texts such as ``lamp1=0.5`` or ``lamp1=1,0.8,0.6`` (red, green,
    blue).

    Raises ValueError for another form, a number that is negative or above :data:`.BRIGHTEST`, a name that is not among
    ``names``, and a second factor of a layer.
    """
    factors = dict[str, np.ndarray]()
    for text in texts:
        name, _, values = text.partition("=")
        factor = np.zeros(0)
        with suppress(ValueError):
            factor = np.array(values.split(","), dtype=np.float64)
        if len(factor) not in (1, 3) or not ((factor >= 0) & (factor <= BRIGHTEST)).all():
            form = f"LAYER=FACTOR, such as light_0=0.5 or light_0=1,0.8,0.6; factors are from 0 to {BRIGHTEST:g}"
            raise ValueError(f"'{text}' is not of the form {form}")
        if name not in names:
            raise ValueError(f"there is no layer '{name}'; there are {', '.join(names)}")
        if name in factors:
            raise ValueError(f"{name} has several factors; give one")
        factors[name] = factor.astype(np.float32)
    return factors


def mixed(
    layers: Mapping[str, np.ndarray], factors: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Multiplies ``layers``, each of shape (height, width, 3), by ``factors``; returns their sum, and the layers.

    ``factors`` maps names of layers to one number, or three for red, green and blue.
    """
    result = {name: values * factors.get(name, np.float32(1)) for name, values in layers.items()}
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
