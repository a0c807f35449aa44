"""From wave to wave: what an image takes, and when it ends."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import drjit as dr
import mitsuba as mi

from .plan import Plan, in_patterns
from .state import State
from .target import Pursuit, Target


def waves(
    plan: Plan,
    policy: Any,
    state: State,
    target: Target,
    tell: Callable[[float], None] | None = None,
    cancelled: Callable[[], bool] = lambda: False,
) -> Iterator[State]:
    """Lets ``state`` grow by ``policy`` (see :mod:`.policies`) until ``target``, if there is one, and yields it after
    each wave; after the first one every pixel has a value. A state with samples and decisions goes on where it is.

    ``tell``: called from time to time with the part done, 0 to 1; ``cancelled``: asked as often whether to stop.
    """
    pixels = dr.width(state.estimate.count)
    begun = policy.first / plan.most  # the first wave's share, as long as nobody knows how many follow
    decisions = state.decisions
    if decisions.need is None:
        first = dr.opaque(mi.UInt32, policy.first, pixels)
        whole = state.grow(state.share(first, policy.reach), policy.quiet, part(tell, 0, begun), cancelled)
        yield state
        if not whole or policy.first == plan.most:
            return
        decisions.need = state.judge(policy.need, policy.reach)
    if target:
        yield from Pursuit(target, state, decisions.need, cancelled).waves(tell)
        return
    state.grow(state.share(in_patterns(plan, decisions.need)), policy.quiet, part(tell, begun, 1), cancelled)
    yield state


def part(tell: Callable[[float], None] | None, begin: float, end: float) -> Callable[[float], None] | None:
    """``tell`` for a part of the whole, from ``begin`` to ``end``."""
    return None if tell is None else lambda done: tell(begin + (end - begin) * done)
