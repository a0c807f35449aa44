"""Says in words where the light of a pixel comes from, and which random numbers of its samples carry the variance.

The share of a dimension, such as the points on lamps, is its total effect (Jansen 1999): half of the mean squared
difference of two samples that differ only in the random numbers of this dimension, divided by the variance of a sample.
The shares sum to more than 1 if the effect of one dimension depends on another.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..engine.plan import Plan
from ..photons.caustics import MAPS
from ..sampling.hash import hash32
from ..sampling.spaces import CAMERA_SPACES, DIFFUSE, NODE_SPACES
from ..transport import lobes
from .recorder import HIDDEN, STATES, VISIBLE, Recorder

#: Number of pairs of samples by which a share is estimated: many, because rare bright samples may have most of it.
PAIRS = 8192
#: Dimension -> what it means, and what would reduce its noise. The first three are the spaces of the camera, in order.
DIMENSIONS = {
    "pixel": ("the place in the pixel", "more samples"),
    "lens": ("the point on the lens", "more samples, or a smaller lens"),
    "time": ("the time", "more samples, or a shorter exposure"),
    "lobe": ("the directions of rays from surfaces", "more samples"),
    "choice": ("the choices of lobes", "more samples"),
    "roulette": ("Russian roulette", "more samples, or less Russian roulette (rr_throughput, in paths rr_depth)"),
    "lamp": ("the choice of a lamp and of a point on it", "more samples"),
    "photons": ("the paths of the photons", f"many more photons (caustic_photons), or more than {MAPS} samples"),
}
PHOTONS = list(DIMENSIONS).index("photons")
#: Numbers of lanes in :class:`Points` that have the points of the pixel, and points that differ in no dimension.
FURTHER, OWN = len(DIMENSIONS), len(DIMENSIONS) + 1
#: A further sample is named if it is this much brighter than all samples of the pixel.
BRIGHTER = 1.5
#: Maximum numbers of sentences on lamps that add no light, and of reasons in a sentence.
MOST_DARK, MOST_CAUSES = 4, 3
#: Points that add no light are named if they are more than this many for each sample.
FEW = 0.05

#: Light that the recorder knows -> its name.
LIGHTS = {
    "photons": "the light of photons on {shape}",
    "ambient": "the ambient term of {shape}",
    "lamp": "the light of {lamp} by way of {shape}",
    "background": "the background {way}",
    "emission": "the light of {lamp} {way}",
}


class Points:
    """The sample points of lanes. Lanes whose ``which`` is :data:`OWN` have the points of :class:`.Plan`. Other lanes
    have other points; two lanes of a pair differ only in the dimension with the number ``which``.
    """

    def __init__(self, plan: Plan, which: mi.UInt32, transport: Any, *where: Any) -> None:
        plans = (replace(plan, uses_sobol=True, shared=0, seed=hash32(plan.seed + number)) for number in (1, 2))
        self.points: list[Any] = [one.points(*where) for one in (plan, *plans)]
        #: The dimension, and the number of spaces of a node.
        self.which, self.spaces = which, NODE_SPACES + transport.lights.count
        own, one, _ = self.points
        self.key, self.division = self._own(own.key, one.key), (self._own(own.division[0], where[2]), own.division[1])
        #: Index of the sample, by which the photon map is chosen.
        self.t = self._own(own.t, one.t + dr.select(which == PHOTONS, mi.UInt32(1), 0))

    def __call__(self, space: Any, active: mi.Bool = True) -> mi.Point2f:
        """Returns the pair of random numbers of a space, as the points of a plan do."""
        return self._chosen(space, *(points(space, active) for points in self.points))

    def choice(self, space: Any) -> mi.Float:
        """Returns the single random number of a space, as the points of a plan do."""
        return self._chosen(space, *(points.choice(space) for points in self.points))

    def _chosen(self, space: Any, own: Any, one: Any, other: Any) -> Any:
        space = mi.UInt32(space)
        # The spaces of the three rays of a node are one dimension, and those of all lamps another one.
        of_node = dr.clip((space - CAMERA_SPACES) % self.spaces, DIFFUSE, NODE_SPACES) + 1
        differs = dr.select(space < CAMERA_SPACES, space, of_node) == self.which
        return self._own(own, dr.select(differs, other, one))

    def _own(self, own: Any, further: Any) -> Any:
        return dr.select(self.which == OWN, own, further)


def shares(luminance: np.ndarray) -> dict[str, float]:
    """Returns the share of each of the :data:`DIMENSIONS` in the variance of the ``luminance`` of further samples, of
    which the last :data:`PAIRS` differ from the others in one dimension each. The result is empty if all are equal.
    """
    *others, last = luminance.reshape(-1, PAIRS)
    variance = float(last.var())
    if not variance > (1e-4 * last.mean()) ** 2:
        return {}
    effects = np.mean((np.array(others) - last) ** 2, axis=1) / (2 * variance)
    # An estimate may be greater than 1, a share may not.
    return dict(zip(DIMENSIONS, np.minimum(effects, 1).tolist()))


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
    times = f"{brighter:.2g} times as bright as" if brighter < 99 else "much brighter than"
    which, (light, remedy) = f"the {count} samples" if count > 1 else "the sample", worst(found, recorder, weights)
    # The shares come from other samples than those that the page shows, which may lack rare bright ones.
    by = f"What carries the variance, by {PAIRS:,} pairs of further samples"
    said = {
        f"{by}: {'; '.join(carried)}.": carried,
        "The shares overlap, because some of these random numbers matter only together.": sum(found.values()) > 1.1,
        "No single kind of random numbers carries half of it.": found[order[0]] < 0.5,
        f"The brightest further sample is {times} any sample here; more samples would show such.": brighter > BRIGHTER,
        f"In {which} farthest from the mean, {light} differs most from that in a middle sample.": light,
        f"What would help: {remedy}.": True,
    }
    return tuple(sentence for sentence, holds in said.items() if holds)


def worst(found: dict[str, float], recorder: Recorder, weights: np.ndarray) -> tuple[str, str]:
    """Returns the name of the light whose weighted sum differs most from 0 (:meth:`.Samples.deviations`), empty if all
    sums are 0, and what would reduce the noise, whose :func:`shares` are ``found``.
    """
    amounts = lights(recorder, weights).items()
    (name, focused), amount = max(amounts, key=lambda item: abs(item[1]), default=(("", False), 0.0))
    dimension = max(found, key=found.__getitem__, default="")
    advice = DIMENSIONS[dimension][1] if found.get(dimension, 0) >= 0.05 else "more samples"
    return name * bool(amount), advice + ", and photons (caustics)" * (focused and dimension in ("lobe", "choice"))


def rarely_met(recorder: Recorder) -> str:
    """Returns a sentence that glass hides lamps from the surfaces, so that rays meet them only by chance; empty if no
    lamp is hidden. Names the lamp only if it is the only one: light through glass does not follow the straight line by
    which the samples find what is in the way.
    """
    hidden = Counter[int]()
    for (state, by), number in recorder.sums("lamp", ("state", "occluder")).items():
        if state == HIDDEN and lobes.has_any(recorder.flags.get(by, 0), *lobes.REFRACTED):
            hidden[by] += number
    if not hidden:
        return ""
    lamp = recorder.lamps[0] if len(recorder.lamps) == 1 else "lamps"
    light = f"the light of {lamp} through {recorder.shape(hidden.most_common(1)[0][0])}"
    return f"{light}, which only rays find that meet a lamp by chance; what would help: photons (caustics)"


def lights(recorder: Recorder, weights: np.ndarray) -> dict[tuple[str, bool], float]:
    """Returns the contributions of each light times the weights of the samples: the name, with the surface from which
    the light comes, and whether photons would find the light better than rays -> contribution.
    """
    amounts, caustics = defaultdict[tuple[str, bool], float](float), recorder.transport.caustics
    for event, name in LIGHTS.items():
        keys = ("shape", "level", "lamp") if event in ("lamp", "emission") else ("shape", "level")
        for (number, level, *lamp), amount in recorder.sums(event, keys, weights).items():
            shape = recorder.shape(number)
            way = f"by way of {shape}" if number else "that the camera sees"
            lamp_name = recorder.lamps[min(lamp[0], len(recorder.lamps) - 1)] if lamp else ""
            focuses = lobes.has_any(recorder.flags.get(number, 0), *lobes.SPECULAR)
            focused = bool(event == "emission" and level > 1 and focuses and not caustics)
            amounts[name.format(shape=shape, lamp=lamp_name, way=way), focused] += amount
    return amounts


def origins(recorder: Recorder, count: int) -> tuple[str, ...]:
    """Returns sentences on the light of all ``count`` samples: where it comes from, and what hides lamps."""
    amounts = Counter[str]()
    for (name, _), amount in lights(recorder, np.ones(count)).items():
        amounts[name] += amount  # type: ignore[assignment]
    total = sum(amounts.values())
    most = [f"{light} ({amount / total:.0%})" for light, amount in amounts.most_common(3) if amount > 0.01 * total]
    said = f"Where the light comes from: {'; '.join(most)}." if total > 0 else "No light comes from here."
    return (said, *hidden_points(recorder, count))


def hidden_points(recorder: Recorder, count: int) -> Iterator[str]:
    """Yields sentences on the points of lamps that add no light to ``count`` samples, of which there are many."""
    groups, clear = defaultdict[tuple[int, ...], Counter[str]](Counter), set[str]()
    transport = recorder.transport
    for (*place, state, by), number in recorder.sums("lamp", ("level", "shape", "lamp", "state", "occluder")).items():
        words, (_, shape, lamp) = f"hidden by {recorder.shape(by)}" if state == HIDDEN else STATES[state], place
        if recorder.shape(shape) != recorder.lamps[lamp]:  # a convex lamp adds no light to itself
            groups[tuple(place)][words] += number
            emitter = transport.lights.emitters[lamp]
            met = emitter.get_shape() is not None or emitter.is_environment()  # by rays of paths
            missed = state == HIDDEN and not (transport.caustics or (met and not transport.settings.follows_tree))
            if missed and lobes.has_any(recorder.flags.get(by, 0), *lobes.REFRACTED):
                clear.add(recorder.shape(by))
    darkest = sorted(groups, key=lambda place: groups[place][STATES[VISIBLE]] - groups[place].total())
    seen = defaultdict[tuple[int, int], list[str]](list)
    for level, shape, lamp in sorted(darkest[:MOST_DARK]):
        counts = groups[level, shape, lamp]
        points = f"of {counts.total()} point{'s' * (counts.total() > 1)} of {recorder.lamps[lamp]}"
        del counts[STATES[VISIBLE]]
        parts = [f"{number} {words}" for words, number in counts.most_common(MOST_CAUSES)]
        if rest := counts.total() - sum(number for _, number in counts.most_common(MOST_CAUSES)):
            parts.append(f"{rest} for other reasons")
        if counts.total() > FEW * count:
            seen[level, shape].append(f"{points}, {', '.join(parts)}")
    for (level, shape), lamps in seen.items():
        yield f"Seen from {recorder.shape(shape)} at level {level}: {'; '.join(lamps)}."
    if clear:
        through = ", ".join(sorted(clear))
        yield f"Light of lamps through {through} is missing, because only caustics find it."
