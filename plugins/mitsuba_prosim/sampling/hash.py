"""Integer hashes, which make a sample a pure function of pixel, space and index."""

from __future__ import annotations

from typing import Any

#: 2^32 over the golden ratio: multiples of it have large distances modulo 2^32.
GOLDEN = 0x9E3779B9


def hash32(x: Any) -> Any:
    """Hashes a 32-bit unsigned integer: the output permutation of PCG-RXS-M-XS-32 (O'Neill 2014; Jarzynski and Olano
    2020).

    ``x`` is a Python integer, a NumPy array or a Dr.Jit array of 32-bit unsigned integers; the result is of the same
    kind and uniform over the 32-bit range. The masks are for Python's unbounded integers: Dr.Jit drops them.
    """
    x = (x * 747796405 + 2891336453) & 0xFFFFFFFF
    x = (((x >> ((x >> 28) + 4)) ^ x) * 277803737) & 0xFFFFFFFF
    return (x >> 22) ^ x


def combine(key: Any, x: Any) -> Any:
    """Hashes integer ``x`` under ``key``; different ``x`` give unrelated results."""
    return hash32((key + (x * GOLDEN & 0xFFFFFFFF)) & 0xFFFFFFFF)
