"""How finely curved faces are approximated, and what is too much."""

import numpy as np

from ..language.document import Document
from .caps import crowded
from .grouping import alike
from .remains import Ball
from .sight import Sight
from .solid import IDENTITY, Solid

TOLERANCE = 0.1  # chord error in pixels
MOST_TRIANGLES = 4_000_000  # of all primitives, about 3 GB while they are united


def choose_segments(
    document: Document, solids: list[Solid], bounds: list[Ball], camera: Sight, tolerance: float
) -> None:
    """Sets ``segments`` of all solids, so that the chord error stays below ``tolerance`` pixels.

    They do not matter outside of ``bounds``; where such a one leaves a cap of a ball, its ``frame`` is set too. Solids
    with a common curved face get the same number. Where that would be more than MOST_TRIANGLES, all are coarser,
    with a :class:`SceneWarning`; where even the coarsest are, that is a :class:`SceneError`.
    """
    wanted = tolerance
    while True:
        for primitive, numbers in alike(s.primitive for s in solids).items():
            places = np.array([solids[i].to_world for i in numbers])
            for i, segments in zip(numbers, primitive.segments(places, camera, tolerance)):
                solids[i].segments = segments
        most: dict[int, int] = {}
        for s, bound in zip(solids, bounds):
            if (surface := s.curved_surface) >= 0:
                most[surface] = max(most.get(surface, 0), s.segments)
            elif s.primitive.axes == 3:
                cap = crowded(s, bound, camera, tolerance)
                s.segments, s.frame = cap or (s.segments, IDENTITY)
        for s in solids:
            s.segments = most.get(s.curved_surface, s.segments)
        total = sum(s.primitive.count(s.segments) for s in solids)
        if total <= MOST_TRIANGLES:
            break
        if total <= sum(s.primitive.count(0) for s in solids):
            raise document.error(
                f"the tree's {len(solids):,} different primitives have at least {total:,} triangles; "
                f"expected {MOST_TRIANGLES:,} at most, which is what memory is provided for",
                "csg",
            )
        tolerance *= 1.5
    if tolerance > wanted:
        document.warn(
            f"curved faces are approximated to {tolerance:.2g} pixels instead of {wanted:g}: "
            f"the tree's {len(solids):,} primitives would have more than {MOST_TRIANGLES:,} triangles",
            "csg",
        )


def warn_if_far(document: Document, camera: Sight, boxes: np.ndarray) -> None:
    """A :class:`SceneWarning` where single precision, in which the renderer computes, is coarse against a pixel.

    ``boxes`` (n, 8, 3) are corners of boxes around the solids.
    """
    low, high = boxes.min(axis=1), boxes.max(axis=1)
    nearest = np.linalg.norm(np.clip(camera.eye, low, high) - camera.eye, axis=1).min()
    pixel = float(camera.footprint(nearest))
    grain = float(np.spacing(np.float32(np.abs(camera.eye).max())))
    if grain > 0.1 * pixel:
        document.warn(
            f"the scene lies so far from the origin that its coordinates are rounded to {grain:.1g} (single precision) "
            f"where a pixel is {pixel:.1g} wide: moved to the origin, it is seen more exactly",
            "view",
            "eye",
        )
