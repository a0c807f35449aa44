"""Which faces of different primitives lie on one plane or quadric.

Two surfaces that are meant to be the same differ by the rounding of transforms and of decimal fractions. They are compared
by their equations, in the space of one of the two primitives, where the rounding is small and a difference that can be
seen is not.
"""

import numpy as np

SAME = 1e-7  # of a quadric's coefficients in a primitive's own space
NEAR = 1e-6  # the same of its coefficients in the whole scene's space: what differs more is not compared


def same_surfaces(quadrics: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """For each of n surfaces the number of one that it is the same as, its representative.

    Surface i is the quadric ``quadrics[i]`` (n, 4, 4) of a primitive's own space, which ``matrices[i]`` (n, 4, 4) takes to
    the world. A representative is its own, and the largest primitive among its like.
    """
    sizes = np.linalg.norm(matrices[:, :3, :3], axis=(1, 2))
    group = _clusters(_features(quadrics, matrices))
    order = np.argsort(-sizes, kind="stable")
    result = np.full(len(quadrics), -1)
    canonical = quadrics / np.linalg.norm(quadrics, axis=(1, 2), keepdims=True)
    while len(order):
        _, first, cluster = np.unique(group[order], return_index=True, return_inverse=True)
        representative = order[first][cluster]
        inverse = np.linalg.inv(matrices[order[first], :3, :3])[cluster]
        relative = np.zeros((len(order), 4, 4))  # from the primitive's own space to the representative's
        relative[:, :3, :3] = inverse @ matrices[order, :3, :3]
        relative[:, :3, 3:] = inverse @ (matrices[order] - matrices[representative])[:, :3, 3:]
        relative[:, 3, 3] = 1
        found = relative.transpose(0, 2, 1) @ quadrics[representative] @ relative
        found /= np.linalg.norm(found, axis=(1, 2), keepdims=True)
        same = np.abs(found - canonical[order]).max(axis=(1, 2)) < SAME
        same |= order == representative
        result[order[same]] = representative[same]
        order = order[~same]
    return result


def _features(quadrics: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """Numbers (n, 10) that are equal for equal surfaces, in a space in which the scene has about the size 1."""
    to_unit = np.eye(4)
    center = matrices[:, :3, 3].mean(axis=0)
    scale = max(np.abs(matrices[:, :3, 3] - center).max(), np.abs(matrices[:, :3, :3]).max())
    to_unit[:3] = np.append(np.eye(3), -center[:, None], axis=1) / scale
    inverse = np.linalg.inv(to_unit @ matrices)
    world = inverse.transpose(0, 2, 1) @ quadrics @ inverse
    world /= np.linalg.norm(world[:, :3, :3], axis=(1, 2))[:, None, None]
    row, column = np.triu_indices(4)
    return world[:, row, column]


def _clusters(values: np.ndarray) -> np.ndarray:
    """Labels of the rows of an array: rows that differ by less than NEAR in every column have the same label."""
    label = np.zeros(len(values), int)
    count = 0
    while count < label.max() + 1:
        count = label.max() + 1
        for column in values.T:
            order = np.lexsort([column, label])
            new = (np.diff(label[order]) != 0) | (np.diff(column[order]) > NEAR)
            label[order] = np.concatenate([[0], np.cumsum(new)])
    return label
