"""From wave to wave: what an image takes, and when it ends."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import drjit as dr
import mitsuba as mi

from .plan import Plan, in_patterns
from .pursuit import Pursuit
from .state import State
from .target import Target, first_in_time

#: A wave takes so many times the samples that a pixel has, at most.
GROWTH = 4


def waves(
    plan: Plan,
    policy: Any,
    state: State,
    target: Target,
    tell: Callable[[float], None] | None = None,
    cancelled: Callable[[], bool] = lambda: False,
) -> Iterator[State]:
    """Lets ``state`` grow by ``policy`` (see :mod:`.policies`) until ``target``, if there is one, and yields it after
    each wave; after the first one every pixel has a value, also where that was stopped after its first portion, if sums
    are kept. A state with samples and decisions goes on where it is.

    ``tell``: called from time to time with the part done, 0 to 1; ``cancelled``: asked as often whether to stop.
    """
    pixels = dr.width(state.estimate.count)
    begun = policy.first / plan.most  # the first wave's share, as long as nobody knows how many follow
    decisions = state.decisions
    if decisions.judged == 0:
        first = state.share(dr.opaque(mi.UInt32, policy.first, pixels), policy.judgements * policy.reach)
        if target.seconds and state.keeps and state.estimator.sampler is None:
            whole = first_in_time(target, state, first, part(tell, 0, begun), cancelled)
        else:
            whole = state.grow(first, policy.quiet, part(tell, 0, begun), cancelled)
        if not whole and state.keeps and dr.any(state.estimate.count > 0):
            state.grow(dr.minimum(first, dr.opaque(mi.UInt32, 1)))  # whoever stops it has a whole image
        yield state
        if not whole or policy.first == plan.most:
            return
    if target:
        decisions.judged = 1
        yield from Pursuit(target, state, policy, cancelled).waves(tell)
        return
    while decisions.wanted is not None or decisions.judged < policy.judgements:
        left = policy.judgements - decisions.judged
        if decisions.wanted is None:
            left -= 1
            # What is to be judged again must be known as far as those after it look.
            wanted = in_patterns(plan, state.judge(policy.need, policy.reach, left * policy.reach))
            if left:
                wanted = dr.minimum(wanted, soon(plan, state.estimate.count))
            decisions.wanted, decisions.judged = state.share(wanted, left * policy.reach), decisions.judged + 1
        end = int(dr.max(decisions.wanted)[0]) / plan.most if left else 1.0
        whole = state.grow(decisions.wanted, policy.quiet, part(tell, begun, end), cancelled)
        if whole:
            decisions.wanted = None
        yield state
        if not whole:
            return
        begun = end


def soon(plan: Plan, count: mi.UInt32) -> mi.UInt32:
    """The most samples that a wave leads to if it is not the last, as few samples know little: a first pattern, or some
    times as many as there are.
    """
    return dr.maximum(GROWTH * count, dr.opaque(mi.UInt32, plan.n**2))


def part(tell: Callable[[float], None] | None, begin: float, end: float) -> Callable[[float], None] | None:
    """``tell`` for a part of the whole, from ``begin`` to ``end``."""
    return None if tell is None else lambda done: tell(begin + (end - begin) * done)
