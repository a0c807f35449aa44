"""A linear image with layers, for the page and the notebook."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import mitsuba as mi
import numpy as np

from ..denoising.layers import mixed
from ..engine.render import Render
from ..scene.images import luminance

#: The layers of every picture but coarse ones.
LAYERS = ("final", "error", "samples")

#: Names of layers of :meth:`.Picture.mixed`, and their factors.
Factors: TypeAlias = Sequence[tuple[str, np.ndarray]]


@dataclass(frozen=True, eq=False)
class Picture:
    """Layers by name, 32-bit arrays: colours (height, width, 3) and maps (height, width). ``number``: unique among the
    pictures of the viewer. Layers of the integrator's parameter ``layers`` have names such as ``lights.lamp1``.
    """

    number: int
    layers: Mapping[str, np.ndarray] = field(default_factory=dict)

    def mixed(self, factors: Factors) -> Picture:
        """This picture with layers of the integrator multiplied, and their sum. Raises KeyError for other names."""
        if not factors:
            return self
        final, layers = mixed({name: values for name, values in self.layers.items() if "." in name}, factors)
        return replace(self, layers={**self.layers, "final": final, **layers})

    def packed(self, layer: str) -> tuple[bytes, dict[str, str]]:
        """The bytes of a layer, row by row, 32-bit little-endian numbers, and its headers. ``X-White`` is the 99th
        percentile, of the luminance for colours.
        """
        values = self.layers[layer]
        height, width = values.shape[:2]
        light = luminance(values) if values.ndim == 3 else values
        white = finite(np.percentile(np.maximum(light, 0), 99))
        facts = {"Picture": self.number, "Width": width, "Height": height, "White": 1.0 if white is None else white}
        return np.nan_to_num(values).astype("<f4").tobytes(), {f"X-{name}": str(fact) for name, fact in facts.items()}

    def at(self, x: int, y: int, size: tuple[int, int]) -> dict[str, list[float | None] | float | None]:
        """The values by layer at pixel (x, y) of an image of ``size``; this picture may be coarser. Values that are not
        finite are None.
        """
        height, width = self.layers["final"].shape[:2]
        x, y = x * width // size[0], y * height // size[1]
        return {
            name: [finite(v) for v in values[y, x]] if values.ndim == 3 else finite(values[y, x])
            for name, values in self.layers.items()
        }


def layers_of_render(render: Render, integrator: mi.Integrator) -> dict[str, np.ndarray]:
    """The :data:`LAYERS` of a render by ``integrator``, and those of the integrator's parameter ``layers``."""
    kind, image = getattr(integrator, "layers", "none"), np.array(render.image())
    layers = {"final": colours(image), "error": render.error(), "samples": render.counts().astype(np.float32)}
    if kind != "none":
        names = [*render.state.estimator.channels.aov_names, *render.own_aovs]
        for k, name in enumerate(render.state.estimator.transport.aov_names, image.shape[2] - len(names)):
            if name.endswith(".R"):
                layers[f"{kind}.{name[:-2]}"] = colours(image[..., k : k + 3])
    return layers


def fill_unknown(known: np.ndarray, values: np.ndarray, before: np.ndarray | None = None) -> np.ndarray:
    """A layer's ``values`` where they are ``known``, shape (height, width); elsewhere those of ``before``, which may be
    coarser, or 0.
    """
    mask = known[..., None] if values.ndim == 3 else known
    if before is None:
        return np.where(mask, values, np.float32(0))
    rows, columns = (np.arange(size) * old // size for size, old in zip(known.shape, before.shape))
    return np.where(mask, values, before[np.ix_(rows, columns)])


def colours(image: np.ndarray) -> np.ndarray:
    """Red, green and blue of a developed image, shape (height, width, channels), which may be grey."""
    image = image.astype(np.float32, copy=False)
    return image[..., :3] if image.shape[2] >= 3 else np.repeat(image[..., :1], 3, axis=2)


def finite(value: float) -> float | None:
    """The number, or None if it is not finite, which JSON cannot express."""
    return float(value) if math.isfinite(value) else None
