"""Masks that are Dr.Jit arrays, or Python booleans in scalar variants (where ``~True`` is -2)."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def but_not(a: mi.Bool, b: mi.Bool) -> mi.Bool:
    """``a`` and not ``b``."""
    return dr.select(b, False, a)


def idle(active: mi.Bool) -> bool:
    """Whether no lane is active, as far as that is known: scalar variants have no shape, BSDF or emitter then."""
    return not dr.is_jit_v(active) and not active
