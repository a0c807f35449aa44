"""Portions of samples as NumPy arrays, to be sent to another process, and the answer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import dr_array
from ..engine.estimate import Estimate, Estimator
from ..engine.plan import Plan, Sampling
from ..engine.work import WorkItem
from ..sampling.nrook import Permutations

#: What says which samples a plan takes; the seed, which may differ from pixel to pixel, is said beside it.
PLANNED = ("n", "least", "full", "most", "endless", "jitter", "window", "domain", "reach", "band")

#: An estimate as rows of one array: these, and then the sums. Its counts are an array of their own.
ROWS = ("total", "squares", "pass_squares", "in_pass")


def request(item: WorkItem) -> dict[str, Any]:
    """What another process has to know to take the samples of ``item``, of the same scene."""
    plan = item.plan
    begun = bool(dr.any(item.start.count > 0))
    return {
        "pixels": dr.width(item.x),
        "x": packed(np.array(item.x)),
        "y": packed(np.array(item.y)),
        "start": [packed(values) for values in rows(item.start)] if begun else None,
        "plan": planned(plan),
        "end": packed(np.array(item.end)),
        "seed": packed(np.array(plan.seed)),
        "photon_seed": plan.photon_seed,
        "quiet": item.quiet is not None,
    }


def planned(plan: Plan) -> tuple[Any, ...]:
    """``plan`` without its seed, to be compared and sent."""
    return (*(getattr(plan, name) for name in PLANNED), tuple(asdict(plan.sampling).values()))


def plan_of(said: tuple[Any, ...]) -> Plan:
    """The plan of which :func:`planned` has said this, with a seed of 0."""
    *values, sampling = said
    facts = dict(zip(PLANNED, values))
    sampling = Sampling(**dict(zip((field.name for field in fields(Sampling)), sampling)))
    return Plan(permutations=Permutations(facts["n"]), seed=mi.UInt32(0), sampling=sampling, **facts)


def portion(message: Mapping[str, Any], plan: Plan, policy: Any, estimator: Estimator) -> WorkItem:
    """The work item that a :func:`request` asks for; ``plan`` and ``policy`` being those of its ``plan``."""
    # A single pixel would have a kernel of its own, as what there is one of is taken for the same in all lanes.
    size = message["pixels"]
    lanes = max(size, 2)

    def array(said: Any) -> Any:
        values = unpacked(said, size)
        return dr_array(values if lanes == size else np.repeat(values, lanes))

    x, y, end = (array(message[name]) for name in ("x", "y", "end"))
    seed = message["seed"]
    seed = dr.opaque(mi.UInt32, int(seed)) if np.ndim(seed) == 0 else array(seed)
    plan = replace(plan, seed=seed, own_photon_seed=message["photon_seed"])
    start = Estimate.nothing(estimator.values, lanes)
    if message["start"] is not None:
        count, *floats = message["start"]
        values = [array(said) for said in floats]
        start = estimate_of(values, array(count))
    quiet = policy.quiet if message["quiet"] else None
    dr.eval(x, y, end, start)
    return WorkItem(estimator, x, y, start, plan, end, quiet, 0, (0.0, 1.0), lambda _: None)


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
