"""Helpers for code that runs in both scalar and vectorised variants of Mitsuba.

In scalar variants, masks are Python booleans (``~True`` is -2), pointers are objects, and loops are loops of Python.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi


def but_not(a: mi.Bool, b: mi.Bool) -> mi.Bool:
    """Returns the mask that is true where ``a`` is true and ``b`` is false."""
    return dr.select(b, False, a)


def idle(active: mi.Bool) -> bool:
    """Tells whether ``active`` is known to be false, which only scalar variants can know: the shape, BSDF or emitter
    that the caller would use may be None.
    """
    return not dr.is_jit_v(active) and not active


def fold(count: int, body: Callable[..., Any], state: Any, active: mi.Bool, unrolled: bool, **options: Any) -> Any:
    """Computes ``state = body(k, state)`` for each k from 0 to ``count`` - 1, and returns the last state.

    Unless ``unrolled``, the kernel contains a loop of the ``active`` lanes, so that it does not depend on ``count``;
    ``options`` are further arguments of ``dr.while_loop``.
    """
    if unrolled or not dr.is_jit_v(mi.Float):
        for k in range(count):
            state = body(k, state)
        return state
    end = dr.opaque(mi.UInt32, count)
    return dr.while_loop(
        (dr.opaque(mi.UInt32, 0), state),
        lambda k, state: active & (k < end),
        lambda k, state: (k + 1, body(k, state)),
        labels=("k", "state"),
        **options,
    )[1]


def dispatch(pointer: Any, function: Callable[..., Any], *args: Any) -> Any:
    """Calls ``function(instance, *args)`` for each instance to which ``pointer`` points, and returns the results.

    ``args`` must hold all Dr.Jit values that the function needs, with the mask last. In scalar variants, ``pointer`` is
    the instance itself.
    """
    return dr.dispatch(pointer, function, *args) if dr.is_jit_v(mi.Float) else function(pointer, *args)
