"""Says in words where the light of a pixel comes from, and which random numbers of its samples carry the variance.

The share of a dimension, such as the points on lamps, is its total effect (Jansen 1999): half of the mean squared
difference of two samples that differ only in the random numbers of this dimension, divided by the variance of a sample.
The shares sum to more than 1 if the effect of one dimension depends on another.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..engine.estimator import Estimator
from ..engine.plan import Plan
from ..photons.caustics import MAPS
from ..sampling.hash import hash32
from ..sampling.spaces import CAMERA_SPACES, DIFFUSE, NODE_SPACES
from .nodes import Node

#: Number of pairs of samples by which a share is estimated.
PAIRS = 1024
#: Dimension -> what it means, and what would reduce its noise. The first three are the spaces of the camera, in order.
DIMENSIONS = {
    "pixel": ("the place in the pixel, at an edge or in a texture", "more samples"),
    "lens": ("the point on the lens", "more samples, or a smaller lens"),
    "time": ("the time", "more samples, or a shorter exposure"),
    "lobe": ("the directions of rays from surfaces", "more samples, and photons (caustics) if the rays look for lamps"),
    "choice": ("the choices of lobes", "more samples"),
    "roulette": ("Russian roulette", "more samples, or less Russian roulette (rr_depth, in trees rr_throughput)"),
    "lamp": ("the choice of a lamp and of a point on it", "more samples, or smaller lamps"),
    "photons": ("the paths of the photons", f"many more photons (caustic_photons), or more than {MAPS} samples"),
}
PHOTONS = list(DIMENSIONS).index("photons")


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

    @property
    def t(self) -> mi.UInt32:
        """Index of the sample, by which the photon map is chosen."""
        return self.one.t + dr.select(self.which == PHOTONS, mi.UInt32(1), 0)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.one, name)

    def _differs(self, space: Any) -> mi.Bool:
        space = mi.UInt32(space)
        # The spaces of the three rays of a node are one dimension, and those of all lamps another one.
        of_node = dr.clip((space - CAMERA_SPACES) % self.spaces, DIFFUSE, NODE_SPACES) + 1
        return dr.select(space < CAMERA_SPACES, space, of_node) == self.which


def shares(estimator: Estimator, plan: Plan, x: int, y: int) -> dict[str, float]:
    """Returns the share of each of the :data:`DIMENSIONS` in the variance of the luminance of the pixel (x, y) of the
    whole film; an empty dictionary if the samples are equal.
    """
    lanes = dr.arange(mi.UInt32, PAIRS * (len(DIMENSIONS) + 1))
    one, other = (replace(plan, uses_sobol=True, shared=0, seed=hash32(plan.seed + number)) for number in (1, 2))
    transport: Any = estimator.transport
    where = dr.opaque(mi.Int32, x, len(lanes)), dr.opaque(mi.Int32, y, len(lanes))
    # The last group of lanes differs in no dimension.
    which, spaces = lanes // PAIRS, NODE_SPACES + transport.lights.count
    pairs: Any = SimpleNamespace(points=lambda *at: Pair(one.points(*at), other.points(*at), which, spaces))
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
        said.append("No single kind of random numbers carries half of it.")
    light, count = noisiest_light(outliers, usual), len(outliers)
    which = f"the {count} samples" if count > 1 else "the sample"
    said.append(f"In {which} farthest from the mean, {light} differs most from that in a middle sample.")
    return (*said, f"What would help: {remedy(found)}.")


def remedy(found: dict[str, float]) -> str:
    """Returns what would reduce the noise, by its :func:`shares`."""
    worst = max(found, key=found.__getitem__, default="")
    return DIMENSIONS[worst][1] if worst and found[worst] >= 0.05 else "more samples"


def noisiest_light(outliers: Sequence[Sequence[Node]], usual: Sequence[Node]) -> str:
    """Returns the name of the light that differs most between the samples ``outliers`` and the middle sample."""
    difference = dict[str, float]()
    for sign, nodes in [*((1.0, nodes) for nodes in outliers), (-float(len(outliers)), usual)]:
        for light, amount in lights(nodes):
            difference[light] = difference.get(light, 0.0) + sign * amount
    return max(difference, key=lambda name: abs(difference[name]))


def lights(nodes: Sequence[Node]) -> Iterator[tuple[str, float]]:
    """Yields a name of each light of a sample, with the surface that scatters it, and the sum of its contribution."""
    surfaces = {node.number: node.shape for node in nodes}
    for node in nodes:
        yield f"the light of photons on {node.shape}", sum(node.photons)
        yield f"the ambient term of {node.shape}", sum(node.ambient)
        for lamp in node.lamps:
            yield f"the light of {lamp.lamp} that {node.shape} scatters", sum(lamp.contribution)
        # The surface where the ray begins scatters the light that the ray finds.
        way = f"that {surfaces[node.parent]} scatters" if node.parent else "that the camera sees"
        yield f"the background {way}", sum(node.background)
        if node.emission:
            yield f"the light of {node.emission.lamp} {way}", sum(node.emission.contribution)


def origins(samples: Sequence[Sequence[Node]]) -> tuple[str, ...]:
    """Returns sentences on the light of the samples with these nodes: where it comes from, and what hides lamps."""
    amounts = defaultdict[str, float](float)
    # Lamp and surface -> the states of the lamp's points, and the shapes that hide them.
    found = defaultdict[tuple[str, str], tuple[Counter[str], set[str]]](lambda: (Counter(), set()))
    for nodes in samples:
        for light, amount in lights(nodes):
            amounts[light] += amount
        for shape, lamp in ((str(node.shape), lamp) for node in nodes for lamp in node.lamps):
            states, occluders = found[lamp.lamp, shape]
            states[lamp.state] += 1
            occluders.update({lamp.occluder} if lamp.occluder else ())
    total = sum(amounts.values())
    brightest = sorted(amounts, key=lambda light: -amounts[light])[:3]
    most = [f"{light} ({amounts[light] / total:.0%})" for light in brightest if amounts[light] > 0.01 * total]
    said = [f"Where the light comes from: {'; '.join(most)}." if total > 0 else "No light comes from here."]
    for (name, shape), (states, occluders) in sorted(found.items(), key=lambda item: -item[1][0]["hidden"])[:3]:
        if hidden := states["hidden"]:
            points = f"{hidden} of {hidden + states['visible']} points of {name}"
            said.append(f"From {shape}, {points} are hidden by {' and '.join(sorted(occluders))}.")
    return tuple(said)
