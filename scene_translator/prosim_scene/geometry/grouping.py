"""Groups equal keys, and finds axis-aligned boxes that overlap or touch."""

from collections.abc import Callable, Hashable, Iterable, Iterator
from typing import TypeVar

import numpy as np

K = TypeVar("K", bound=Hashable)


def group_equal(keys: Iterable[K]) -> dict[K, list[int]]:
    """Returns a dictionary from each distinct key to the positions (from 0) in ``keys`` at which the key occurs."""
    groups: dict[K, list[int]] = {}
    for number, key in enumerate(keys):
        groups.setdefault(key, []).append(number)
    return groups


MAX_PAIRS = 1 << 16  # the largest number of pairs that are tested at a time


def sweep(low: np.ndarray, high: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yields arrays of pairs of boxes, ``low`` to ``high`` (n, 3), that touch or overlap, at most MAX_PAIRS at once
    or all of one box. Pairs are sorted by the minimum x of their first box; their second box does not begin before.
    """
    order = np.argsort(low[:, 0], kind="stable")
    low, high = low[order], high[order]
    # Sweep along x: box i may touch the boxes from i + 1 to last[i] - 1, which begin before box i ends.
    last = np.searchsorted(low[:, 0], high[:, 0], side="right")
    counts = np.maximum(last - np.arange(len(order)) - 1, 0)
    ends = np.cumsum(counts)
    begin = 0
    while begin < len(order):
        tested = ends[begin - 1] if begin else 0
        end = max(int(np.searchsorted(ends, tested + MAX_PAIRS, side="right")), begin + 1)
        first = np.repeat(np.arange(begin, end), counts[begin:end])
        second = np.arange(len(first)) - np.repeat(ends[begin:end] - counts[begin:end] - tested, counts[begin:end])
        second += first + 1
        for axis in (1, 2):
            touches = (low[second, axis] <= high[first, axis]) & (high[second, axis] >= low[first, axis])
            first, second = first[touches], second[touches]
        if len(first):
            yield order[first], order[second]
        begin = end


def touching(boxes: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Returns the numbers, ascending, of the ``boxes`` (n, 2, 3) that touch or overlap ``box`` (2, 3)."""
    return np.flatnonzero(((boxes[:, 0] <= box[1]) & (boxes[:, 1] >= box[0])).all(axis=1))


def components(
    low: np.ndarray, high: np.ndarray, connected: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
) -> np.ndarray:
    """Returns the smallest box number in each box's connected component of touching boxes; ``connected(first,
    second)``, if it is given, tells which touching pairs are connected.
    """
    label = np.arange(len(low))
    for first, second in sweep(low, high):
        if connected:  # only pairs that are not yet in one component need a test
            pairs = np.stack([first, second])[:, label[first] != label[second]]
            first, second = pairs[:, connected(*pairs)]
        a, b = label[first], label[second]
        while (a != b).any():
            np.minimum.at(label, np.maximum(a, b), np.minimum(a, b))
            while (label[label] != label).any():
                label = label[label]
            a, b = label[first], label[second]
    return label
