"""Boxes that overlap or touch."""

from collections.abc import Iterator

import numpy as np


def sweep(low: np.ndarray, high: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """The number of each of n boxes, in the order of their least x, and the numbers of those after it that touch it.

    ``low``, ``high`` (n, 3) are their min and max corners.
    """
    order = np.argsort(low[:, 0], kind="stable")
    low, high = low[order], high[order]
    last = np.searchsorted(low[:, 0], high[:, 0], side="right")  # sweep along x
    for i, number in enumerate(order.tolist()):
        window = slice(i + 1, last[i])
        hits = np.all((low[window, 1:] <= high[i, 1:]) & (high[window, 1:] >= low[i, 1:]), axis=1)
        yield number, order[window][hits]
