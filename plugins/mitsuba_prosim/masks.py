"""Where scalar variants differ: masks are Python booleans there (``~True`` is -2), pointers are objects."""

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


def dispatch(pointer: Any, function: Callable[..., Any], *args: Any) -> Any:
    """The results of ``function(instance, *args)`` for the instances of a Dr.Jit ``pointer``: once for each kind, with
    everything that it computes with among ``args``, the mask last. In scalar variants ``pointer`` is the instance.
    """
    return dr.dispatch(pointer, function, *args) if dr.is_jit_v(mi.Float) else function(pointer, *args)
