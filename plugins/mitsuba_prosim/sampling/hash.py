"""Integer hash functions, which make a sample a pure function of pixel, space (pair of random numbers) and index."""

from typing import Any

#: 2^32 divided by the golden ratio: the multiples of this number are far from each other modulo 2^32.
GOLDEN = 0x9E3779B9


def hash32(x: Any) -> Any:
    """Returns a hash of the 32-bit unsigned integer ``x`` (of Python, NumPy or Dr.Jit), by the output permutation of
    PCG-RXS-M-XS-32 (O'Neill 2014; Jarzynski and Olano 2020). It has the type of ``x``, and is uniform.

    The masks with 0xFFFFFFFF are needed for Python's unbounded integers; Dr.Jit removes them.
    """
    x = (x * 747796405 + 2891336453) & 0xFFFFFFFF
    x = (((x >> ((x >> 28) + 4)) ^ x) * 277803737) & 0xFFFFFFFF
    return (x >> 22) ^ x


def combine(key: Any, x: Any) -> Any:
    """Returns a hash of the integer ``x`` for the hash key ``key``; the hashes of different ``x`` are unrelated."""
    return hash32((key + (x * GOLDEN & 0xFFFFFFFF)) & 0xFFFFFFFF)
