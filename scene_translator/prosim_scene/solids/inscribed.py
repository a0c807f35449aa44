"""Balls that touch another solid's curved face from within, such as a ball in a pipe of its own width.

Both faces are approximated by chords, and near the line or the point where they touch, the inner one's facets would
stand out of the outer one's: patches of the wrong solid, many pixels wide although far thinner than a pixel. So the
inner one is made smaller, by no more than the chord error of the outer one.
"""

import numpy as np

from .placing import corners
from .solid import Solid
from .sweep import sweep

CONTAINED = 1e-6  # of the outer quadric's value at points of the inner face; 0 on the quadric, -1 in its middle
SPACING = 0.004  # how far below 0 that value may be where the faces touch between the points that are looked at


def shrink_inscribed(solids: list[Solid]) -> None:
    """Sets ``shrink`` of the solids that touch another's curved face from within; ``segments`` have been chosen."""
    curved = [s for s in solids if s.primitive.curved is not None]
    pairs = _touching(curved)
    bounds = [
        (inner, outer)
        for i, j in pairs
        for inner, outer in ((curved[i], curved[j]), (curved[j], curved[i]))
        if _touches_within(inner, outer)
    ]
    for _ in range(len(bounds)):  # a chain of inscribed solids takes as many rounds as it is long
        changed = False
        for inner, outer in bounds:
            gap = 1 - outer.inradius * outer.shrink
            factor = max(1 - gap * outer.widest / inner.narrowest, 0.5)
            if factor < inner.shrink:
                changed = True
                for s in [inner] if inner.curved_surface < 0 else solids:
                    if s is inner or s.curved_surface == inner.curved_surface:
                        s.shrink = factor
        if not changed:
            break


def _touching(solids: list[Solid]) -> list[tuple[int, int]]:
    """Pairs of solids with overlapping boxes and different curved faces."""
    boxes = corners(solids)
    surface = np.array([s.curved_surface for s in solids])
    found = []
    for first, second in sweep(boxes.min(axis=1), boxes.max(axis=1)):
        chosen = (surface[first] < 0) | (surface[first] != surface[second])
        found += list(zip(first[chosen].tolist(), second[chosen].tolist()))
    return found


def _touches_within(inner: Solid, outer: Solid) -> bool:
    """Whether the inner solid is a ball that lies within the quadric of the outer one's curved face, and touches it.

    A pipe or a cone would touch it along a generator or with its rim, where a gap could be taken for a wall.
    """
    if inner.primitive.axes < 3:
        return False
    relative = np.linalg.solve(outer.to_world, inner.to_world)
    quadric = outer.primitive.quadrics[outer.primitive.curved]
    points = inner.primitive.lines.reshape(-1, 3)
    for some in (points[:: max(len(points) // 8, 1)], points):  # few points tell most pairs apart
        p = some @ relative[:3, :3].T + relative[:3, 3]
        if outer.primitive.two_sheets and (p[:, 2] < -CONTAINED).any():
            return False
        value = np.einsum("ij,ij->i", p @ quadric[:3, :3], p) + 2 * p @ quadric[:3, 3] + quadric[3, 3]
        if (value > CONTAINED).any():
            return False
    return bool(value.max() > -SPACING - 4 * (1 - outer.inradius))
