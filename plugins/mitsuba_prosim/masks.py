"""Masks that are Dr.Jit arrays, or Python booleans in scalar variants (where ``~True`` is -2)."""

import drjit as dr


def but_not(a, b):
    """``a`` and not ``b``."""
    return dr.select(b, False, a)


def idle(active):
    """Whether no lane is active, as far as that is known: scalar variants have no shape, BSDF or emitter then."""
    return not dr.is_jit_v(active) and not active
