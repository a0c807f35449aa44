"""The planes between which Mitsuba's cameras see: wide enough for all of the scene, as the language clips nothing."""

from collections.abc import Iterable, Sequence

import numpy as np

from ..model import Light
from ..solids import Triangles
from ..view import Camera

#: By default, in units of the view plane's distance.
NEAR, FAR = 1e-3, 1e5


def planes(camera: Camera, bodies: Sequence[Triangles], lights: Iterable[Light]) -> tuple[float, float]:
    """Depths of the near and the far plane that cut off no triangle of the ``bodies``, and no light.

    The near plane is moved to the eye where something lies before it, but never on the eye.
    """
    near, far = NEAR * camera.depth, FAR * camera.depth
    for light in lights:
        if light.kind == "sky":
            continue
        far = max(far, 2 * (float(_depth(camera, np.array(light.position))) + light.radius))
    extent = 0.0
    for body in bodies:
        far = max(far, 2 * float(_depth(camera, body.vertices).max()))
        extent = max(extent, float(np.abs(body.vertices - camera.eye).max()))
    corner = np.linalg.norm(
        [max(abs(camera.left), abs(camera.right)), max(abs(camera.bottom), abs(camera.top)), camera.depth]
    )
    slant = float(corner / camera.depth)  # how much longer the way is in a corner of the image
    distance = min((_distance(camera.eye, body, near * slant) for body in bodies), default=np.inf)
    if distance < near * slant:
        near = max(distance / (2 * slant), 1e-9 * extent)
    return near, far


def _depth(camera: Camera, points: np.ndarray) -> np.ndarray:
    return np.asarray((camera.eye - points) @ camera.n)


def _distance(point: np.ndarray, body: Triangles, reach: float) -> float:
    """Distance from a point to the nearest triangle; infinite where none comes within ``reach``."""
    below, above = body.vertices < point + reach, body.vertices > point - reach
    if not (below.any(axis=0) & above.any(axis=0)).all():
        return np.inf
    close = np.all(below[body.index].any(axis=1) & above[body.index].any(axis=1), axis=1)
    corners = body.vertices[body.index[close]] - point
    if not len(corners):
        return np.inf
    a, b = corners, np.roll(corners, -1, axis=1)
    edge = b - a
    length = np.maximum(np.einsum("tij,tij->ti", edge, edge), 1e-300)
    along = np.clip(-np.einsum("tij,tij->ti", a, edge) / length, 0, 1)
    result = float(np.linalg.norm(a + along[..., None] * edge, axis=2).min())
    # The foot on the plane, where it lies within the triangle: to the same side of all edges.
    normal = np.cross(edge[:, 0], edge[:, 1])
    sides = np.einsum("tij,tj->ti", np.cross(edge, -a), normal)
    within = np.all(sides >= 0, axis=1) & (np.abs(normal).max(axis=1) > 0)
    if within.any():
        size = np.linalg.norm(normal[within], axis=1)
        result = min(result, float(np.abs(np.einsum("tj,tj->t", corners[within, 0], normal[within]) / size).min()))
    return result
