"""Where scalar variants differ: masks are Python booleans there (``~True`` is -2), pointers are objects, loops are
Python's.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi


def but_not(a: mi.Bool, b: mi.Bool) -> mi.Bool:
    """``a`` and not ``b``."""
    return dr.select(b, False, a)


def idle(active: mi.Bool) -> bool:
    """Whether it is known that no lane is active: scalar variants then have no shape, BSDF or emitter."""
    return not dr.is_jit_v(active) and not active


def fold(
    first: int, end: int, body: Callable[..., Any], state: Any, active: mi.Bool, unrolled: bool, **options: Any
) -> Any:
    """The last ``state = body(k, state)`` for k from ``first`` to ``end`` - 1: in the kernel one after the other if
    ``unrolled``, else by a loop with these ``options``, whose kernel does not depend on their number.
    """
    if unrolled or not dr.is_jit_v(mi.Float):
        for k in range(first, end):
            state = body(k, state)
        return state
    count = dr.opaque(mi.UInt32, end)
    return dr.while_loop(
        (dr.opaque(mi.UInt32, first), state),
        lambda k, state: active & (k < count),
        lambda k, state: (k + 1, body(k, state)),
        labels=("k", "state"),
        **options,
    )[1]


def dispatch(pointer: Any, function: Callable[..., Any], *args: Any) -> Any:
    """The results of ``function(instance, *args)`` for the instances of a Dr.Jit ``pointer``: once for each kind, with
    everything that it computes with among ``args``, the mask last. In scalar variants ``pointer`` is the instance.
    """
    return dr.dispatch(pointer, function, *args) if dr.is_jit_v(mi.Float) else function(pointer, *args)
