"""Portions of samples as NumPy arrays, to be sent to another process, and the answer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..engine.estimate import Estimate, Estimator
from ..engine.plan import Plan, Sampling
from ..engine.record import dr_array
from ..engine.work import WorkItem
from ..sampling.nrook import Permutations

#: What says which samples a plan takes; the seed, which may differ from pixel to pixel, is said beside it.
PLANNED = ("n", "least", "full", "most", "jitter", "window", "domain", "reach", "band")

#: An estimate as rows of one array: these, and then the sums. Its counts are an array of their own.
ROWS = ("total", "squares", "pass_squares", "in_pass")


def request(portion: WorkItem) -> dict[str, Any]:
    """What another process has to know to take the samples of ``portion``, of the same scene."""
    (plan, _), *_ = reversed(portion.stages)
    begun = bool(dr.any(portion.start.count > 0))
    return {
        "pixels": dr.width(portion.x),
        "x": packed(np.array(portion.x)),
        "y": packed(np.array(portion.y)),
        "start": [packed(values) for values in rows(portion.start)] if begun else None,
        "plan": planned(plan),
        "stages": [(plan.before is None, packed(np.array(end))) for plan, end in portion.stages],
        "seed": packed(np.array(plan.seed)),
        "photon_seed": plan.photon_seed,
        "quiet": portion.quiet is not None,
    }


def planned(plan: Plan) -> tuple[Any, ...]:
    """``plan`` without its seed, to be compared and sent."""
    first = plan.before or plan
    sampling = tuple(asdict(plan.sampling).values())
    later = None if plan.before is None else (plan.n, plan.begin)
    return (*(getattr(first, name) for name in PLANNED), sampling, later)


def plan_of(said: tuple[Any, ...]) -> Plan:
    """The plan of which :func:`planned` has said this, with a seed of 0."""
    *values, sampling, later = said
    facts = dict(zip(PLANNED, values))
    sampling = Sampling(**dict(zip((field.name for field in fields(Sampling)), sampling)))
    first = Plan(permutations=Permutations(facts["n"]), seed=mi.UInt32(0), sampling=sampling, **facts)
    return first.continued(*later) if later else first


def portion(message: Mapping[str, Any], plan: Plan, policy: Any, estimator: Estimator) -> WorkItem:
    """The portion that a :func:`request` asks for; ``plan`` and ``policy`` being those of its ``plan``."""
    # A single pixel would have a kernel of its own, as what there is one of is taken for the same in all lanes.
    size = message["pixels"]
    lanes = max(size, 2)

    def array(said: Any) -> Any:
        values = unpacked(said, size)
        return dr_array(values if lanes == size else np.repeat(values, lanes))

    estimator.plan = plan
    x, y = (array(message[name]) for name in ("x", "y"))
    seed = message["seed"]
    seed = dr.opaque(mi.UInt32, int(seed)) if np.ndim(seed) == 0 else array(seed)
    first = plan.before or plan
    own = {"seed": seed, "own_photon_seed": message["photon_seed"]}
    plans = {True: replace(first, **own), False: replace(plan, **own)}
    stages = [(plans[is_first], array(end)) for is_first, end in message["stages"]]
    start = Estimate.nothing(estimator.values, lanes)
    if message["start"] is not None:
        count, *floats = message["start"]
        values = [array(said) for said in floats]
        start = estimate_of(values, array(count))
    quiet = policy.quiet if message["quiet"] else None
    dr.eval(x, y, stages, start)
    return WorkItem(estimator, x, y, start, stages, quiet, 0, (0.0, 1.0), lambda _: None)


def answer(estimate: Estimate, pixels: int) -> tuple[np.ndarray, np.ndarray]:
    """``(counts, values)``: shapes (pixels,) and (values, pixels)."""
    count, *floats = rows(estimate)
    return count[:pixels], np.stack([values[:pixels] for values in floats])


def answered(count: np.ndarray, values: np.ndarray) -> Estimate:
    """The estimate that is the :func:`answer`."""
    floats = [dr_array(row) for row in values]
    estimate = estimate_of(floats, dr_array(count))
    dr.eval(estimate)
    return estimate


def estimate_of(floats: list[mi.Float], count: mi.UInt32) -> Estimate:
    """The estimate of which these are the :func:`rows`."""
    return Estimate(floats[len(ROWS) :], count=count, **dict(zip(ROWS, floats)))


def rows(estimate: Estimate) -> list[np.ndarray]:
    """The arrays of an estimate: its counts, :data:`ROWS` and its sums."""
    floats = [*(getattr(estimate, name) for name in ROWS), *estimate.sums]
    return [np.array(estimate.count), *(np.array(values) for values in floats)]


def packed(values: np.ndarray) -> np.ndarray | np.generic:
    """One number for all, where they are the same to the bit."""
    bits = values.view(np.uint32)
    return values[0] if len(values) and bool(np.all(bits == bits[0])) else values


def unpacked(said: np.ndarray | np.generic, size: int) -> np.ndarray:
    """All of them again."""
    return np.full(size, said) if np.ndim(said) == 0 else np.asarray(said)
