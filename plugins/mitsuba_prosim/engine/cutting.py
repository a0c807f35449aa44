"""How the samples that pixels lack are cut: into steps, and these into portions."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

if TYPE_CHECKING:
    from .state import State

#: Pixels of a portion, where it is the number of their samples that bounds it.
FEWEST = 4096


def steps(count: mi.UInt32, wanted: mi.UInt32, state: State) -> Iterator[tuple[mi.UInt32, tuple[float, float]]]:
    """What is ``wanted`` of those that have ``count``, step by step: ``(wanted so far, (part done before, then))``.

    There is one step, but for caustics: each set of photons is drawn once then, by whoever takes samples. Here all
    pixels come on alike, and between two sets one can stop; elsewhere a step has as many sets as one keeps from portion
    to portion. The parts are those of the time, of which a set takes as much however few samples it is for.
    """
    caustics = state.estimator.transport.caustics
    if caustics is None:
        yield wanted, (0.0, 1.0)
        return
    maps = caustics.maps(state.plan.first.n)
    further = maps * (1 if state.taker.in_turn else caustics.kept)
    have, want = (np.array(values, dtype=np.int64) for values in (count, wanted))
    lacking = want > have
    have, want = have[lacking], want[lacking]
    if not have.size:
        return
    begun = int(have.min()) // maps * maps
    ends = range(begun + further, int(want.max()) + further, further)
    taken = [0, *(int(np.sum(np.maximum(np.minimum(want, end) - have, 0))) for end in ends)]
    costs = [samples + state.set_cost * further / maps * number for number, samples in enumerate(taken)]
    for number, end in enumerate(ends):
        span = costs[number] / costs[-1], costs[number + 1] / costs[-1]
        yield dr.minimum(wanted, dr.opaque(mi.UInt32, end)), span


def portions(
    count: mi.UInt32, wanted: mi.UInt32, state: State, step: tuple[float, float]
) -> Iterator[tuple[tuple[float, float], mi.UInt32, int]]:
    """Numbers of those that lack samples, so many at a time that the bounds of ``state`` are kept to: ``((part done
    before, then), numbers, samples)``. ``step``: the part done before and after all of them.
    """
    plan = state.plan
    # A sampler that is given takes whole patterns only.
    classes = by_lack(count, wanted, 1.5 if state.estimator.sampler is None else 1.0)
    work, finished = sum(size * each for _, size, each in classes), 0
    for where, size, each in classes:
        most = lanes = max(min(plan.band, FEWEST), plan.band * min(plan.n**2, each) // each)
        begin = end = 0
        while end < size:
            bound = state.taker.bound(state.portion, work - finished)
            if bound is not None:  # it may change on the way
                lanes = max(1, min(most, bound // each))
            begin, end = end, min(end + lanes, size)
            some = where
            if end - begin < size:
                some = dr.gather(mi.UInt32, where, dr.arange(mi.UInt32, end - begin) + dr.opaque(mi.UInt32, begin))
            before, finished = finished, finished + (end - begin) * each
            first, last = (step[0] + (step[1] - step[0]) * part / work for part in (before, finished))
            yield (first, last), some, finished - before


def by_lack(count: mi.UInt32, wanted: mi.UInt32, ratio: float) -> list[tuple[mi.UInt32, int, int]]:
    """Those that lack samples, in classes that lack about as many, so that few lanes wait for others: ``(numbers, how
    many they are, most samples that one lacks)``. ``ratio``: of the most to the fewest in a class. Those that lack most
    come first: whoever stops in between has what is noisiest.
    """
    lacking = wanted - dr.minimum(count, wanted)
    dr.eval(lacking)
    sizes = np.bincount(np.array(lacking))
    sizes[0] = 0
    classes, low = [], 0
    for fewest in map(int, np.flatnonzero(sizes)):
        if fewest <= low:
            continue
        low = int(fewest * ratio)
        size = int(sizes[fewest : low + 1].sum())
        if size == dr.width(wanted):
            where = dr.arange(mi.UInt32, size)
        else:
            first, last = dr.opaque(mi.UInt32, fewest), dr.opaque(mi.UInt32, low)
            where = dr.compress((lacking >= first) & (lacking <= last))
        classes.append((where, size, min(low, len(sizes) - 1)))
    return classes[::-1]
