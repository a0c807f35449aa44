"""Says in words where the light of a pixel comes from, and which random numbers of its samples carry the variance.

The share of a dimension, such as the points on lamps, is its total effect (Jansen 1999): half of the mean squared
difference of two samples that differ only in the random numbers of this dimension, divided by the variance of a sample.
The shares sum to more than 1 if the effect of one dimension depends on another.
"""

from __future__ import annotations

from collections import defaultdict
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
from .recorder import HIDDEN, VISIBLE, Recorder

#: Number of pairs of samples by which a share is estimated: many, because rare bright samples may have most of it.
PAIRS = 8192
#: Dimension -> what it means, and what would reduce its noise. The first three are the spaces of the camera, in order.
DIMENSIONS = {
    "pixel": ("the place in the pixel", "more samples"),
    "lens": ("the point on the lens", "more samples, or a smaller lens"),
    "time": ("the time", "more samples, or a shorter exposure"),
    "lobe": ("the directions of rays from surfaces", "more samples, and photons (caustics) if the rays look for lamps"),
    "choice": ("the choices of lobes", "more samples"),
    "roulette": ("Russian roulette", "more samples, or less Russian roulette (rr_depth, in trees rr_throughput)"),
    "lamp": ("the choice of a lamp and of a point on it", "more samples, or smaller lamps"),
    "photons": ("the paths of the photons", f"many more photons (caustic_photons), or more than {MAPS} samples"),
}
PHOTONS = list(DIMENSIONS).index("photons")

#: Light that the recorder knows -> its name.
LIGHTS = {
    "photons": "the light of photons on {shape}",
    "ambient": "the ambient term of {shape}",
    "lamp": "the light of {lamp} that {shape} scatters",
    "background": "the background {way}",
    "emission": "the light of {lamp} {way}",
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


def shares(estimator: Estimator, plan: Plan, x: int, y: int, channels: int) -> tuple[dict[str, float], float]:
    """Returns the share of each of the :data:`DIMENSIONS` in the variance of the luminance of the pixel (x, y) of the
    whole film, and the greatest sum of the first ``channels`` channels of a sample. The dictionary is empty if the
    samples are equal.
    """
    lanes = dr.arange(mi.UInt32, PAIRS * (len(DIMENSIONS) + 1))
    one, other = (replace(plan, uses_sobol=True, shared=0, seed=hash32(plan.seed + number)) for number in (1, 2))
    transport: Any = estimator.transport
    where = dr.opaque(mi.Int32, x, len(lanes)), dr.opaque(mi.Int32, y, len(lanes))
    # The last group of lanes differs in no dimension.
    which, spaces = lanes // PAIRS, NODE_SPACES + transport.lights.count
    pairs: Any = SimpleNamespace(points=lambda *at: Pair(one.points(*at), other.points(*at), which, spaces))
    taken, luminance, _ = estimator.sample(pairs, *where, lanes % PAIRS)
    results = luminance, sum(taken[:channels], mi.Float(0))
    dr.eval(results)  # together, in one kernel
    # One value if the scene is empty.
    values, light = (np.broadcast_to(np.array(v, np.float64), len(lanes)).reshape(-1, PAIRS) for v in results)
    variance = float(values[-1].var())
    if not variance > (1e-4 * values[-1].mean()) ** 2:
        return {}, float(light[-1].max())
    effects = np.mean((values[:-1] - values[-1]) ** 2, axis=1) / (2 * variance)
    # An estimate may be greater than 1, a share may not.
    return dict(zip(DIMENSIONS, np.minimum(effects, 1).tolist())), float(light[-1].max())


def sentences(
    found: dict[str, float], brighter: float, recorder: Recorder, weights: np.ndarray, count: int
) -> tuple[str, ...]:
    """Returns sentences on the noise of a pixel: which dimensions carry it, where the outliers come from, and what
    would help.

    ``found`` are the :func:`shares`, and ``brighter`` is the ratio of the brightest sample among theirs to the
    brightest sample of the pixel; ``weights`` and ``count`` are those of :meth:`.Samples.deviations`.
    """
    if not found:
        return ("All samples are equal, so the pixel has no noise.",)
    order = sorted(found, key=found.__getitem__, reverse=True)
    carried = [f"{DIMENSIONS[name][0]} ({found[name]:.0%})" for name in order if found[name] >= 0.05]
    # The shares come from other samples than those that the page shows, which may lack rare bright ones.
    by = f"What carries the variance, by {PAIRS:,} pairs of further samples"
    said = [f"{by}: {'; '.join(carried)}."] if carried else []
    if sum(found.values()) > 1.1:
        said.append("The shares overlap, because some of these random numbers matter only together.")
    if found[order[0]] < 0.5:
        said.append("No single kind of random numbers carries half of it.")
    if brighter > 1.5:
        times = f"{brighter:.2g} times as bright as" if brighter < 1000 else "much brighter than"
        said.append(f"The brightest further sample is {times} any sample here; more samples would show such.")
    which = f"the {count} samples" if count > 1 else "the sample"
    light = noisiest_light(recorder, weights)
    said.append(f"In {which} farthest from the mean, {light} differs most from that in a middle sample.")
    return (*said, f"What would help: {remedy(found)}.")


def remedy(found: dict[str, float]) -> str:
    """Returns what would reduce the noise, by its :func:`shares`."""
    worst = max(found, key=found.__getitem__, default="")
    return DIMENSIONS[worst][1] if worst and found[worst] >= 0.05 else "more samples"


def noisiest_light(recorder: Recorder, weights: np.ndarray) -> str:
    """Returns the name of the light whose weighted sum differs most from 0 (:meth:`.Samples.deviations`)."""
    return max(amounts := lights(recorder, weights), key=lambda name: abs(amounts[name]))


def lights(recorder: Recorder, weights: np.ndarray) -> dict[str, float]:
    """Returns the contributions of each light, with the surface that scatters it, times the weights of the samples."""
    amounts = defaultdict[str, float](float)
    for event, name in LIGHTS.items():
        keys = ("shape", "lamp") if event in ("lamp", "emission") else ("shape",)
        for (number, *lamp), amount in recorder.sums(event, keys, weights).items():
            shape = recorder.shape(number)
            way = f"that {shape} scatters" if number else "that the camera sees"
            lamp_name = recorder.lamps[min(lamp[0], len(recorder.lamps) - 1)] if lamp else ""
            amounts[name.format(shape=shape, lamp=lamp_name, way=way)] += amount
    return amounts


def origins(recorder: Recorder, count: int) -> tuple[str, ...]:
    """Returns sentences on the light of all ``count`` samples: where it comes from, and what hides lamps."""
    amounts = lights(recorder, np.ones(count))
    total = sum(amounts.values())
    brightest = sorted(amounts, key=lambda light: -amounts[light])[:3]
    most = [f"{light} ({amounts[light] / total:.0%})" for light in brightest if amounts[light] > 0.01 * total]
    said = [f"Where the light comes from: {'; '.join(most)}." if total > 0 else "No light comes from here."]
    states = recorder.sums("lamp", ("lamp", "shape", "state"))
    occluders = recorder.sums("lamp", ("lamp", "shape", "occluder"))
    hidden = [(lamp, shape) for (lamp, shape, state), _ in states.most_common() if state == HIDDEN]
    for lamp, shape in hidden[:3]:
        count, seen = states[lamp, shape, HIDDEN], states[lamp, shape, VISIBLE]
        by = sorted({recorder.shape(other) for *pair, other in occluders if pair == [lamp, shape] and other})
        points = f"{count} of {count + seen} points of {recorder.lamps[lamp]}"
        said.append(f"Seen from {recorder.shape(shape)}, {points} are hidden by {' and '.join(by)}.")
    return tuple(said)
