"""TRANSFORM -> 4x4 matrix."""

import math
from functools import lru_cache

import numpy as np

from .. import model


@lru_cache(maxsize=1 << 15)
def matrix(transform: model.Transform) -> np.ndarray:
    """The 4x4 matrix of a TRANSFORM: its steps in the order in which they are applied. It cannot be written to."""
    result = np.eye(4)
    for step in transform.steps:
        m = np.eye(4)
        if step.kind == "scale":
            m[[0, 1, 2], [0, 1, 2]] = step.values
        elif step.kind == "translate":
            m[:3, 3] = step.values
        else:
            quarters, rest = divmod(step.values[0], 90)  # a right angle is exact
            sine, cosine = math.sin(math.radians(rest)), math.cos(math.radians(rest))
            for _ in range(int(quarters % 4)):
                sine, cosine = cosine, -sine
            i, j = {"rotate-x": (1, 2), "rotate-y": (2, 0), "rotate-z": (0, 1)}[step.kind]
            m[i, i] = m[j, j] = cosine
            m[j, i], m[i, j] = sine, -sine
        result = m @ result
    result.flags.writeable = False
    return result
