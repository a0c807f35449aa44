"""An image for the page: linear, in layers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from ..denoising.layers import mixed
from ..engine.render import Render

#: The layers of every picture but coarse ones.
LAYERS = ("final", "error", "samples")

#: Names of layers of :meth:`.Picture.mixed`, and their factors.
Factors: TypeAlias = Sequence[tuple[str, np.ndarray]]

#: The largest number that 16 bits of floating point hold.
LARGEST = 65504.0


@dataclass(frozen=True, eq=False)
class Picture:
    """Layers by name, arrays of 32 bits: colours (height, width, 3), maps (height, width). ``number``: no other picture
    of the viewer has it. Those of the integrator's parameter ``layers`` have names such as ``lights.lamp1``.
    """

    number: int
    layers: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        height, width = self.layers["final"].shape[:2]
        return width, height

    def mixed(self, factors: Factors) -> Picture:
        """This with layers of the integrator multiplied, and their sum. Raises KeyError for other names."""
        if not factors:
            return self
        final, layers = mixed({name: values for name, values in self.layers.items() if "." in name}, factors)
        return replace(self, layers={**self.layers, "final": final, **layers})

    def packed(self, layer: str) -> tuple[bytes, dict[str, str]]:
        """The bytes of a layer, row by row, little-endian, and its headers. Colours have 16 bits per channel, maps 32.

        ``X-White`` is the 99th percentile, of the luminance for colours. Colours are divided by ``X-Unit``, a power of
        two, as 16 bits do not hold very dark and very bright images.
        """
        values = self.layers[layer]
        height, width = values.shape[:2]
        light, unit = values, 1.0
        if values.ndim == 3:
            light = np.maximum(values @ np.array([0.2126, 0.7152, 0.0722], dtype=np.float32), 0)
        white = float(np.percentile(light, 99))
        white = white if math.isfinite(white) else 1.0
        if values.ndim == 3:
            unit = power_of_two(white or finite(light.max()) or 1.0)
            numbers = values if np.isfinite(light).all() else np.nan_to_num(values)
            content = np.clip(numbers / np.float32(unit), -LARGEST, LARGEST).astype("<f2").tobytes()
        else:
            content = values.astype("<f4").tobytes()
        facts = {"Picture": self.number, "Width": width, "Height": height, "White": white, "Unit": unit}
        return content, {f"X-{name}": str(value) for name, value in facts.items()}

    def at(self, x: int, y: int, size: tuple[int, int]) -> dict[str, list[float | None] | float | None]:
        """The values by layer at pixel (x, y) of an image of ``size``; this picture may be coarser. Values that are not
        finite are None.
        """
        found: dict[str, list[float | None] | float | None] = {}
        x, y = x * self.size[0] // size[0], y * self.size[1] // size[1]
        for name, values in self.layers.items():
            value = values[y, x]
            found[name] = [finite(v) for v in value] if np.ndim(value) else finite(value)
        return found


def of_render(render: Render, kind: str = "none") -> dict[str, np.ndarray]:
    """The :data:`LAYERS` of a render, and those of the integrator's parameter ``layers``, which is ``kind``; 0 at
    pixels without a sample.
    """
    counts = render.counts()
    known = counts > 0
    image = np.array(render.image())
    layers = {"final": colours(image), "error": render.error(), "samples": counts.astype(np.float32)}
    if kind != "none":
        names = render.state.estimator.channels.names
        names = names[names.index("W") + 1 :] + list(render.own_aovs)
        for k, name in enumerate(render.state.estimator.transport.aov_names, image.shape[2] - len(names)):
            if name.endswith(".R"):
                layers[f"{kind}.{name[:-2]}"] = colours(image[..., k : k + 3])
    return layers if known.all() else {name: over(known, values) for name, values in layers.items()}


def over(known: np.ndarray, values: np.ndarray, before: np.ndarray | None = None) -> np.ndarray:
    """A layer's ``values`` where they are ``known``, shape (height, width); elsewhere those of ``before``, which may be
    coarser, or 0.
    """
    mask = known[..., None] if values.ndim == 3 else known
    if before is None:
        return np.where(mask, values, np.float32(0))
    rows, columns = (np.arange(size) * old // size for size, old in zip(known.shape, before.shape))
    return np.where(mask, values, before[np.ix_(rows, columns)])


#: The colours of a map from 0 up: dark blue, violet, red, orange, pale yellow.
HUES = np.array([(8, 8, 48), (92, 20, 122), (205, 55, 70), (248, 156, 40), (252, 250, 190)], dtype=np.float32) / 255


def palest(values: np.ndarray) -> float:
    """The value of the palest colour of a map: its 99th percentile."""
    most = float(np.percentile(values, 99))
    return most if math.isfinite(most) and most > 0 else 1.0


def coloured(values: np.ndarray) -> np.ndarray:
    """A map, shape (height, width), as colours of the screen, shape (height, width, 3), by the square root of the value
    over :func:`palest`.
    """
    place = np.sqrt(np.clip(np.nan_to_num(values) / palest(values), 0, 1))
    return np.stack([np.interp(place, np.linspace(0, 1, len(HUES)), hue) for hue in HUES.T], axis=2)


def colours(image: np.ndarray) -> np.ndarray:
    """Red, green and blue of a developed image, shape (height, width, channels), which may be grey."""
    image = image.astype(np.float32, copy=False)
    return image[..., :3] if image.shape[2] >= 3 else np.repeat(image[..., :1], 3, axis=2)


def power_of_two(value: float) -> float:
    """The largest power of two not above a positive number, within the range of single precision."""
    return 2.0 ** min(max(math.frexp(value)[1] - 1, -100), 100)


def finite(value: float) -> float | None:
    """The number, or None if it is not finite, which JSON can't express."""
    return float(value) if math.isfinite(value) else None
