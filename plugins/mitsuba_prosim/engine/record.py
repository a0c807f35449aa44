"""An image on its way as numbers in memory: what a process that goes on with it has to know, and no more."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from ..compat import dr_array
from .decisions import Decisions
from .estimate import Estimate
from .part import Part, Tiles
from .state import State

#: What ``Sampling`` says that has no say in which samples an image takes.
FREE = ("band",)

#: What of the rest may be other than it was, as long as nothing that was decided by it is kept.
AIMS = ("adaptive", "threshold", "max_samples", "noise", "noise_99", "noise_999", "time")

#: What decisions of the first wave do not depend on.
ENDS = ("noise", "noise_99", "noise_999", "time")

#: Names of an estimate's arrays, without its sums.
STATISTICS = ("total", "squares", "pass_squares", "in_pass")

#: Names of what was decided of each pixel.
DECIDED = ("need", "wanted")


@dataclass(frozen=True)
class Record:
    """A :class:`~mitsuba_prosim.engine.state.State` between two steps, as NumPy arrays, to the bit.

    ``facts``: what can be said in words and numbers (they are JSON); ``pixels``: name -> values of all pixels that are
    known, shape (height, width); ``twin``: name -> values of the twin's pixels, shape (pixels,); ``image``: name ->
    channels of the image, where the sums of its samples are not kept, shape (height, width). ``about``: what those who
    keep it say of where it comes from, in JSON.
    """

    facts: Mapping[str, Any]
    pixels: Mapping[str, np.ndarray]
    twin: Mapping[str, np.ndarray]
    image: Mapping[str, np.ndarray]
    about: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, state: State, seconds: float, finished: bool = False) -> Record:
        """``state`` as it is, after so many seconds; ``finished``: whether it has all that was asked for."""
        plan, decisions = state.plan, state.decisions
        made, row = decisions.rows or (state.made, None)
        facts = {
            "samples": identity(state),
            "sampling": {name: value for name, value in asdict(plan.sampling).items() if name not in FREE},
            "part": None if state.part is None else (state.part.number, state.part.of),
            "region": state.plan.region,
            "endless": state.plan.endless,
            "tiles": None if state.tiles is None else (state.tiles.columns, state.tiles.rows),
            "known": state.outer,
            "noise": state.noise,
            "noise_99": state.noise_99,
            "noise_999": state.noise_999,
            "judged": decisions.judged,
            "effort": decisions.effort,
            "seconds": seconds,
            "row": row,
            "finished": finished,
        }
        others = {name: getattr(decisions, name) for name in DECIDED}
        pixels = arrays(state.estimate, state) | {k: np.array(v) for k, v in others.items() if v is not None}
        left, top, right, bottom = state.outer
        return cls(
            json.loads(json.dumps(facts)),
            {name: values.reshape(bottom - top, right - left) for name, values in pixels.items()},
            {} if decisions.twin is None else arrays(decisions.twin, state),
            {} if made is None else dict(zip(channels(state), np.moveaxis(made.planes(), 2, 0))),
        )

    @property
    def finished(self) -> bool:
        """Whether the image has all that was asked for."""
        return bool(self.facts["finished"])

    @property
    def part(self) -> Part | None:
        """The part of the image that it is of; None for all."""
        return Part(*self.facts["part"]) if self.facts["part"] else None

    @property
    def tiles(self) -> Tiles | None:
        """How the image is cut that it is a part of; None for all."""
        if self.part is None:
            return None
        (left, top, right, bottom), (columns, rows) = self.facts["region"], self.facts["tiles"]
        return Tiles((left, top, right, bottom), columns, rows, self.part.of)

    def difference(self, state: State) -> str | None:
        """Why the samples are not those of ``state``, in words; None where they are."""
        theirs = json.loads(json.dumps(identity(state)))
        return next(
            (
                f"{name}: {mine} there, {theirs.get(name)} here"
                for name, mine in self.facts["samples"].items()
                if mine != theirs.get(name)
            ),
            None,
        )

    def same_aim(self, state: State) -> bool:
        """Whether it was to become what ``state`` is to become."""
        return self._agrees(state, AIMS)

    def restore(self, state: State) -> None:
        """Makes this what ``state``, which has no samples yet, is. What was decided for another aim is decided anew.

        Raises ValueError where these are the samples of another image.
        """
        if difference := self.difference(state):
            raise ValueError(f"these are the samples of another image ({difference})")
        decided = self._agrees(state, [name for name in AIMS if name not in ENDS])
        if not decided and state.plan.sampling.adaptive == "neighbours":
            raise ValueError(
                "adaptive = neighbours decides once, by the first samples alone; let graded go on where threshold, "
                "max_samples or adaptive are not what they were"
            )
        state.keeps = any(name not in (*STATISTICS, "count", *DECIDED) for name in self.pixels)
        state.estimate = estimate({name: self._placed(self.pixels[name], state) for name in names(state)}, state)
        # Further samples may be of an endless sequence where the first ones are N-rook patterns, but not the reverse.
        state.plan = replace(state.plan, endless=state.plan.endless or self.facts["endless"])
        state.noise, state.noise_99, state.noise_999 = (self.facts[name] for name in ("noise", "noise_99", "noise_999"))
        state.decisions = Decisions(twin=estimate(self.twin, state) if self.twin else None)
        if decided:
            state.decisions.judged, state.decisions.effort = self.facts["judged"], self.facts["effort"]
            for name in DECIDED:
                if name in self.pixels:
                    setattr(state.decisions, name, dr_array(self._placed(self.pixels[name], state)))
        if self.image:
            image = state.made = state.black()
            image.values = dr_array(np.stack([self.image[name] for name in channels(state)], axis=-1))
            if self.facts["row"] is not None:
                state.decisions.rows = (image, self.facts["row"])

    def _agrees(self, state: State, parameters: Sequence[str]) -> bool:
        theirs = asdict(state.plan.sampling)
        return all(self.facts["sampling"][name] == theirs[name] for name in parameters)

    def _placed(self, values: np.ndarray, state: State) -> np.ndarray:
        """A plane, laid out over what ``state`` knows: where its decisions look farther, that is more."""
        mine, theirs = tuple(self.facts["known"]), state.outer
        if mine == theirs:
            return values
        result = np.zeros((theirs[3] - theirs[1], theirs[2] - theirs[0]), dtype=values.dtype)
        left, top = max(mine[0], theirs[0]), max(mine[1], theirs[1])
        right, bottom = min(mine[2], theirs[2]), min(mine[3], theirs[3])
        part = values[top - mine[1] : bottom - mine[1], left - mine[0] : right - mine[0]]
        result[top - theirs[1] : bottom - theirs[1], left - theirs[0] : right - theirs[0]] = part
        return result


def identity(state: State) -> dict[str, Any]:
    """What says which samples an image takes, and what is kept of them, in words for people."""
    first, caustics = state.plan, state.estimator.transport.caustics
    return {
        "samples of a pass": first.n,
        "samples that every pixel gets": first.least,
        "jitter": first.jitter,
        "photons of a set": None if caustics is None else caustics.count,
        "seed": int(first.seed[0]),
        "window": first.window,
        "pixels that have samples": first.domain,
        "reach of the filter": first.reach,
        "channels": channels(state),
    }


def channels(state: State) -> list[str]:
    """Names of the image's channels."""
    return [*state.estimator.channels.names, *state.own_aovs]


def names(state: State) -> list[str]:
    """Names of the arrays of an estimate, in the order of :func:`arrays`: ``sum.R`` or, where the filter reaches other
    pixels, ``sum-1+2.R`` for what goes a row up and two columns to the right.
    """
    reach = state.plan.reach
    offsets = [f"{y:+d}{x:+d}" for y in range(-reach, reach + 1) for x in range(-reach, reach + 1)] if reach else [""]
    sums = [f"sum{offset}.{name}" for offset in offsets for name in state.estimator.channels.names]
    return [*STATISTICS, "count", *(sums if state.keeps else [])]


def arrays(estimate: Estimate, state: State) -> dict[str, np.ndarray]:
    """The arrays of an estimate by name."""
    values = [*(getattr(estimate, name) for name in STATISTICS), estimate.count, *estimate.sums]
    return {name: np.array(value) for name, value in zip(names(state), values)}


def estimate(arrays: Mapping[str, np.ndarray], state: State) -> Estimate:
    """The estimate of which these are the arrays."""
    statistics = {name: dr_array(arrays[name]) for name in (*STATISTICS, "count")}
    sums = [dr_array(arrays[name]) for name in names(state)[len(statistics) :]]
    return Estimate(sums=sums, **statistics)
