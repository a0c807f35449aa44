"""Converts TRANSFORM statements to matrices."""

import math
from collections.abc import Sequence

import numpy as np

from .. import model
from .grouping import group_equal

AXES = {"rotate-x": (1, 2), "rotate-y": (2, 0), "rotate-z": (0, 1)}  # turns the first axis towards the second


def matrices(transforms: Sequence[model.Transform]) -> np.ndarray:
    """Returns the matrices (n, 4, 4) of n TRANSFORMs; each matrix applies the steps of its TRANSFORM in the written
    order.

    The matrices of all TRANSFORMs with the same sequence of step kinds, such as scale and translate, are computed in
    one batch.
    """
    result = np.tile(np.eye(4), (len(transforms), 1, 1))
    for kinds, numbers in group_equal(tuple(step.kind for step in transform.steps) for transform in transforms).items():
        batch = result[numbers]
        for i, kind in enumerate(kinds):
            batch = _matrices(kind, np.array([transforms[n].steps[i].values for n in numbers])) @ batch
        result[numbers] = batch
    return result


def _matrices(kind: str, values: np.ndarray) -> np.ndarray:
    result = np.tile(np.eye(4), (len(values), 1, 1))
    if kind == "scale":
        result[:, [0, 1, 2], [0, 1, 2]] = values
    elif kind == "translate":
        result[:, :3, 3] = values
    elif kind == "matrix":
        result[:, :3] = values.reshape(-1, 3, 4)
    else:
        quarters, rest = np.divmod(values[:, 0], 90)  # multiples of 90 degrees have no rounding error
        angles = np.radians(rest).tolist()
        sine, cosine = np.array([(math.sin(a), math.cos(a)) for a in angles]).T
        quarter = (quarters % 4).astype(int)
        i, j = AXES[kind]
        result[:, i, i] = result[:, j, j] = np.choose(quarter, [cosine, -sine, -cosine, sine])
        result[:, j, i] = np.choose(quarter, [sine, cosine, -sine, -cosine])
        result[:, i, j] = -result[:, j, i]
    return result
