"""Single precision, which is Mitsuba's: what it cannot hold is an error, and where it is too coarse for a picture."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from .. import geometry
from ..language.document import Document
from ..nodes import Default, Node
from .view import Camera

#: The largest number whose square single precision still holds.
LARGEST = 1e19
#: How much of a pixel the rounding of coordinates may move a point, before it is said.
COARSE = 0.25


def check(document: Document, node: Node, *path: str | int) -> Node:
    """The node itself, if Mitsuba can hold its numbers; a SceneError about what stands at ``path`` if not."""
    for value in _numbers(node):
        if not abs(value) <= LARGEST:
            raise document.error(f"this comes to {value:g}, which is beyond single precision, Mitsuba's; expected less "
                                 "extreme numbers", *path)
    return node


def check_transforms(document: Document) -> None:
    """Raises the SceneError about a transform that leads beyond single precision."""
    for index, transform in document.scene.transforms.items():
        with np.errstate(all="ignore"):
            matrix = geometry.matrix(transform)
        if not np.abs(matrix).max() <= LARGEST or np.linalg.svd(matrix[:3, :3], compute_uv=False).min() < 1 / LARGEST:
            raise document.error("these steps together lead beyond single precision, Mitsuba's; expected less extreme factors "
                                 "and distances", "transforms", index)


def _numbers(value: Any) -> Iterable[float]:
    if isinstance(value, dict):
        for part in value.values():
            yield from _numbers(part)
    elif isinstance(value, Default):
        yield value.value
    elif isinstance(value, np.ndarray | list | tuple):
        yield from np.ravel(value).tolist()
    elif isinstance(value, int | float):
        yield value


def coarseness(camera: Camera, points: np.ndarray) -> float:
    """How far single precision moves the points (n, 3) of a scene in the image: the median, in pixels."""
    depth = (camera.eye - points) @ camera.n
    seen = depth > 0
    if not seen.any():
        return 0.0
    size = np.maximum(np.abs(points[seen]).max(axis=1), np.abs(camera.eye).max())
    return float(np.median(size / depth[seen]) * 2.0**-24 * camera.depth / min(camera.pixel))


def warn_of_coarseness(document: Document, camera: Camera, points: np.ndarray) -> None:
    """Warns of a scene so far from the origin that the rounding of coordinates shows."""
    pixels = coarseness(camera, points)
    if pixels > COARSE and math.isfinite(pixels):
        document.warn(f"this scene lies so far from the origin that single precision, Mitsuba's, moves what is seen by "
                      f"{pixels:.1g} pixels; move it to the origin", "view", "eye")
