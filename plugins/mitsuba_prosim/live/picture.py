"""A linear image with layers, for the web page and the notebook view."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeAlias

import mitsuba as mi
import numpy as np

from ..engine.render import Render
from ..scene.channels import mixed
from ..scene.images import compress, luminance, png

#: Names of layers, and the factors by which :meth:`.Picture.mixed` multiplies them.
Factors: TypeAlias = Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Picture:
    """An image that is ready to be shown; no two pictures of a viewer have the same ``number``.

    ``layers`` are 32-bit arrays by name: colours, shape (height, width, 3), or a map, shape (height, width). Those that
    the integrator's parameter ``layers`` requests have names such as ``lights.lamp1``.
    """

    number: int
    layers: Mapping[str, np.ndarray]

    def mixed(self, factors: Factors) -> Picture:
        """Returns the picture with some layers of the integrator multiplied by ``factors``; ``final`` is then the sum
        of these layers. Without factors, nothing changes.
        """
        if not factors:
            return self
        final, layers = mixed({name: values for name, values in self.layers.items() if "." in name}, factors)
        return replace(self, layers={**self.layers, "final": final, **layers})

    def packed(self, layer: str) -> tuple[bytes, dict[str, str]]:
        """Returns ``(content, headers)`` of the HTTP response with a layer.

        ``content`` has the values row by row, as 32-bit little-endian floating-point numbers, with 0 for NaN, and the
        greatest finite number for infinity. The header ``X-White`` is the 99th percentile of the map, or of the
        luminance of the colours; 1 if it is not finite. Raises KeyError if the picture has no such layer.
        """
        values = self.layers[layer]
        height, width = values.shape[:2]
        light = luminance(values) if values.ndim == 3 else values
        white = finite_or_none(np.percentile(np.maximum(light, 0), 99))
        facts = {"Picture": self.number, "Width": width, "Height": height, "White": 1.0 if white is None else white}
        return np.nan_to_num(values).astype("<f4").tobytes(), {f"X-{name}": str(fact) for name, fact in facts.items()}

    def at(self, x: int, y: int, size: tuple[int, int]) -> dict[str, list[float | None] | float | None]:
        """Returns the values of all layers at pixel (x, y) of the final image, whose (width, height) is ``size``: three
        numbers for colours, one for a map. Numbers that are not finite become None. A coarse picture has fewer pixels.
        """
        height, width = self.layers["final"].shape[:2]
        x, y = x * width // size[0], y * height // size[1]
        return {
            name: [finite_or_none(v) for v in values[y, x]] if values.ndim == 3 else finite_or_none(values[y, x])
            for name, values in self.layers.items()
        }


def layers_of_render(render: Render, integrator: mi.Integrator) -> dict[str, np.ndarray]:
    """Returns the layers ``final``, ``error`` and ``samples`` of a render, and those that the integrator's parameter
    ``layers`` requests, with names such as ``lights.lamp1``.
    """
    kind, image, estimator = getattr(integrator, "layers", "none"), np.array(render.image()), render.state.estimator
    first = image.shape[2] - len(estimator.channels.aov_names)  # the first AOV; before it are the colours and alpha
    final = colours(image[..., :first])
    layers = {"final": final, "error": render.error(), "samples": render.counts().astype(np.float32)}
    if kind != "none":
        for k, name in enumerate(estimator.transport.aov_names, first):
            if name.endswith(".R"):
                layers[f"{kind}.{name[:-2]}"] = colours(image[..., k : k + 3])
    return layers


def fill_unknown(known: np.ndarray, values: np.ndarray, previous: np.ndarray | None = None) -> np.ndarray:
    """Returns the ``values`` of a layer where the mask ``known``, shape (height, width), is True, else those of the
    layer ``previous``, which may have fewer pixels, or 0.
    """
    mask = known[..., None] if values.ndim == 3 else known
    if previous is None:
        return np.where(mask, values, np.float32(0))
    rows, columns = (np.arange(size) * old // size for size, old in zip(known.shape, previous.shape))
    return np.where(mask, values, previous[np.ix_(rows, columns)])


def colours(image: np.ndarray) -> np.ndarray:
    """Returns the colours of a developed image, shape (height, width, channels): its first three channels, or a grey
    image three times.
    """
    image = image.astype(np.float32, copy=False)
    return image[..., :3] if image.shape[2] >= 3 else np.repeat(image[..., :1], 3, axis=2)


def as_png(values: np.ndarray) -> bytes:
    """Returns a PNG file of a layer: of colours with compressed highlights, or of a map as a grey image, in which the
    99th percentile is white.
    """
    if values.ndim == 2:
        white = finite_or_none(np.percentile(values, 99)) or 1.0
        return png(np.repeat(values[..., None] / np.float32(white), 3, axis=2))
    return png(compress(values))


def finite_or_none(value: float) -> float | None:
    """Returns ``value``, or None if it is infinite or NaN, because JSON has only finite numbers."""
    return float(value) if math.isfinite(value) else None
