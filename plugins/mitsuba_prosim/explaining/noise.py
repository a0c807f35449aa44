"""Finds which random numbers of the samples of a pixel carry the variance, and says so in words.

The share of a dimension, such as the points on lamps, is its total effect (Jansen 1999): half of the mean squared
difference of two samples that differ only in the random numbers of this dimension, divided by the variance of a sample.
The shares sum to more than 1 if the effect of one dimension depends on another.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..engine.estimator import Estimator
from ..engine.plan import Plan
from ..sampling.hash import hash32
from ..sampling.spaces import CAMERA_SPACES, CHOICE, NODE_SPACES
from .nodes import Node

#: Number of pairs of samples by which a share is estimated.
PAIRS = 1024
#: Dimension -> what it means, and what would reduce its noise. The first three are the spaces of the camera, in order.
DIMENSIONS = {
    "pixel": ("the place in the pixel, at an edge or in a texture", "more samples"),
    "lens": ("the point on the lens", "more samples, or a smaller lens"),
    "time": ("the time", "more samples, or a shorter exposure"),
    "lobe": ("the directions of rays from surfaces", "more samples, and photons (caustics) if the rays look for lamps"),
    "choice": ("the choices of lobes and of Russian roulette", "more samples, or less Russian roulette (rr_depth)"),
    "lamp": ("the choice of a lamp and of a point on it", "more samples, or smaller lamps"),
}


@dataclass
class Pair:
    """Points whose random numbers of the dimension number ``which`` are those of ``other``, the rest of ``one``."""

    one: Any
    other: Any
    which: mi.UInt32
    #: Number of spaces of a node.
    spaces: int

    def __call__(self, space: Any, active: mi.Bool = True) -> mi.Point2f:
        """Returns the pair of random numbers of a space, as the points of a plan do."""
        return dr.select(self._differs(space), self.other(space, active), self.one(space, active))

    def choice(self, space: Any) -> mi.Float:
        """Returns the single random number of a space, as the points of a plan do."""
        return dr.select(self._differs(space), self.other.choice(space), self.one.choice(space))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.one, name)

    def _differs(self, space: Any) -> mi.Bool:
        space = mi.UInt32(space)
        k = (space - CAMERA_SPACES) % self.spaces
        of_node = dr.select(k < CHOICE, mi.UInt32(3), dr.select(k < NODE_SPACES, mi.UInt32(4), 5))
        return dr.select(space < CAMERA_SPACES, space, of_node) == self.which


@dataclass
class Pairs:
    """A plan whose points are a :class:`Pair`."""

    plan: Plan
    other: Plan
    which: mi.UInt32
    spaces: int

    def points(self, *where: Any) -> Any:
        """Returns the points of samples of pixels, see :meth:`.Plan.points`."""
        return Pair(self.plan.points(*where), self.other.points(*where), self.which, self.spaces)


def shares(estimator: Estimator, plan: Plan, x: int, y: int) -> dict[str, float]:
    """Returns the share of each of the :data:`DIMENSIONS` in the variance of the luminance of the pixel (x, y) of the
    whole film; an empty dictionary if the samples are equal.
    """
    lanes = dr.arange(mi.UInt32, PAIRS * (len(DIMENSIONS) + 1))
    one, other = (replace(plan, uses_sobol=True, shared=0, seed=hash32(plan.seed + number)) for number in (1, 2))
    transport: Any = estimator.transport
    # The last group of lanes differs in no dimension.
    pairs: Any = Pairs(one, other, lanes // PAIRS, NODE_SPACES + transport.lights.count)
    where = dr.opaque(mi.Int32, x, len(lanes)), dr.opaque(mi.Int32, y, len(lanes))
    values = np.array(estimator.sample(pairs, *where, lanes % PAIRS)[1], np.float64).reshape(-1, PAIRS)
    variance = float(values[-1].var())
    if not variance > (1e-4 * values[-1].mean()) ** 2:
        return {}
    effects = np.mean((values[:-1] - values[-1]) ** 2, axis=1) / (2 * variance)
    return dict(zip(DIMENSIONS, effects.tolist()))


def sentences(found: dict[str, float], outliers: Sequence[Sequence[Node]], usual: Sequence[Node]) -> tuple[str, ...]:
    """Returns sentences on the noise of a pixel: which dimensions carry it, where the outliers come from, and what
    would help.

    ``found`` are the :func:`shares`, ``outliers`` the nodes of the samples that are farthest from the mean, and
    ``usual`` the nodes of the middle sample.
    """
    if not found:
        return ("All samples are equal, so the pixel has no noise.",)
    order = sorted(found, key=found.__getitem__, reverse=True)
    carried = [f"{DIMENSIONS[name][0]} ({found[name]:.0%})" for name in order if found[name] >= 0.05]
    said = [f"What carries the variance: {'; '.join(carried)}."] if carried else []
    if found[order[0]] < 0.5:
        return (*said, "No single kind of random numbers carries half of it: photons or wavelengths may do.")
    difference = dict[str, float]()
    for sign, nodes in [*((1.0, nodes) for nodes in outliers), (-float(len(outliers)), usual)]:
        for light, amount in lights(nodes):
            difference[light] = difference.get(light, 0.0) + sign * amount
    light, count = max(difference, key=lambda name: abs(difference[name])), len(outliers)
    which = f"the {count} samples" if count > 1 else "the sample"
    said.append(f"In {which} farthest from the mean, the light of {light} differs most from that in a middle sample.")
    return (*said, f"What would help: {DIMENSIONS[order[0]][1]}.")


def lights(nodes: Sequence[Node]) -> Iterator[tuple[str, float]]:
    """Yields a name of each light of a sample, with the surface that scatters it, and the sum of its contribution."""
    surfaces = {node.number: node.shape for node in nodes}
    for node in nodes:
        parts = [(lamp.lamp, node.shape, lamp.contribution) for lamp in node.lamps]
        if node.emission:  # the surface where the ray begins scatters this light
            parts.append((node.emission.lamp, surfaces.get(node.parent), node.emission.contribution))
        parts += [(name, node.shape, getattr(node, name)) for name in ("photons", "ambient", "background")]
        for light, shape, contribution in parts:
            yield light + (f" by {shape}" if shape else ", seen directly"), sum(contribution)
