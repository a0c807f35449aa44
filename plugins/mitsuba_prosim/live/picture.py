"""A linear image with layers, for the page and for the notebook."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import mitsuba as mi
import numpy as np

from ..denoising.layers import mixed
from ..engine.render import Render
from ..scene.images import luminance

#: The layers that every picture has, except for a coarse picture.
LAYERS = ("final", "error", "samples")

#: Names of layers, and the factors by which :meth:`.Picture.mixed` multiplies them.
Factors: TypeAlias = Sequence[tuple[str, np.ndarray]]


@dataclass(frozen=True, eq=False)
class Picture:
    """An image that is ready to be shown: name of a layer -> 32-bit array.

    Layers are colours, shape (height, width, 3), or maps, shape (height, width). ``number`` is unique among the
    pictures of a viewer. Layers of the integrator's parameter ``layers`` have names such as ``lights.lamp1``.
    """

    number: int
    layers: Mapping[str, np.ndarray]

    def mixed(self, factors: Factors) -> Picture:
        """Returns the picture after a multiplication of layers of the integrator by ``factors``.

        The layer ``final`` of the result is the sum of the multiplied layers. Raises KeyError for a name that is not a
        layer of the integrator.
        """
        if not factors:
            return self
        final, layers = mixed({name: values for name, values in self.layers.items() if "." in name}, factors)
        return replace(self, layers={**self.layers, "final": final, **layers})

    def packed(self, layer: str) -> tuple[bytes, dict[str, str]]:
        """Returns ``(content, headers)`` of the HTTP response for a layer.

        ``content`` has the values row by row as 32-bit little-endian numbers. The header ``X-White`` is the 99th
        percentile of the values of a map, or of the luminance of colours.
        """
        values = self.layers[layer]
        height, width = values.shape[:2]
        light = luminance(values) if values.ndim == 3 else values
        white = finite_or_none(np.percentile(np.maximum(light, 0), 99))
        facts = {"Picture": self.number, "Width": width, "Height": height, "White": 1.0 if white is None else white}
        return np.nan_to_num(values).astype("<f4").tobytes(), {f"X-{name}": str(fact) for name, fact in facts.items()}

    def at(self, x: int, y: int, size: tuple[int, int]) -> dict[str, list[float | None] | float | None]:
        """Returns the value of each layer at pixel (x, y) of the final image: name of the layer -> value.

        ``size`` is the (width, height) of the final image. A coarse picture has fewer pixels. Values that are not
        finite are None.
        """
        height, width = self.layers["final"].shape[:2]
        x, y = x * width // size[0], y * height // size[1]
        return {
            name: [finite_or_none(v) for v in values[y, x]] if values.ndim == 3 else finite_or_none(values[y, x])
            for name, values in self.layers.items()
        }


def layers_of_render(render: Render, integrator: mi.Integrator) -> dict[str, np.ndarray]:
    """Returns the :data:`LAYERS` of a render, and the layers of the integrator's parameter ``layers``: name -> array.

    The layers of the integrator get names such as ``lights.lamp1``. They are channels of the developed image, before
    the other AOVs.
    """
    kind, image = getattr(integrator, "layers", "none"), np.array(render.image())
    layers = {"final": colours(image), "error": render.error(), "samples": render.counts().astype(np.float32)}
    if kind != "none":
        names = render.state.estimator.channels.aov_names
        for k, name in enumerate(render.state.estimator.transport.aov_names, image.shape[2] - len(names)):
            if name.endswith(".R"):
                layers[f"{kind}.{name[:-2]}"] = colours(image[..., k : k + 3])
    return layers


def fill_unknown(known: np.ndarray, values: np.ndarray, previous: np.ndarray | None = None) -> np.ndarray:
    """Returns a layer with ``values`` where the mask ``known``, shape (height, width), is True.

    Pixels where ``known`` is False are taken from the layer ``previous``, which may have fewer pixels. Without
    ``previous`` such pixels are 0.
    """
    mask = known[..., None] if values.ndim == 3 else known
    if previous is None:
        return np.where(mask, values, np.float32(0))
    rows, columns = (np.arange(size) * old // size for size, old in zip(known.shape, previous.shape))
    return np.where(mask, values, previous[np.ix_(rows, columns)])


def colours(image: np.ndarray) -> np.ndarray:
    """Returns red, green and blue of a developed image of shape (height, width, channels), which may be grey."""
    image = image.astype(np.float32, copy=False)
    return image[..., :3] if image.shape[2] >= 3 else np.repeat(image[..., :1], 3, axis=2)


def finite_or_none(value: float) -> float | None:
    """Returns the number, or None if it is not finite, because JSON has only finite numbers."""
    return float(value) if math.isfinite(value) else None
