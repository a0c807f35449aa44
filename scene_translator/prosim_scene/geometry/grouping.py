"""Equal keys, and boxes that overlap or touch."""

from collections.abc import Hashable, Iterable, Iterator
from typing import TypeVar

import numpy as np

K = TypeVar("K", bound=Hashable)


def group_equal(keys: Iterable[K]) -> dict[K, list[int]]:
    """The positions of equal keys, from 0, by key."""
    groups: dict[K, list[int]] = {}
    for number, key in enumerate(keys):
        groups.setdefault(key, []).append(number)
    return groups


MAX_PAIRS = 1 << 20  # at a time


def sweep(low: np.ndarray, high: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Pairs of touching boxes, each once and many at a time, as two arrays of their numbers.

    ``low``, ``high`` (n, 3) are their min and max corners. The first box of a pair has
    the smaller x; pairs are in the order of it.
    """
    order = np.argsort(low[:, 0], kind="stable")
    low, high = low[order], high[order]
    last = np.searchsorted(low[:, 0], high[:, 0], side="right")  # sweep along x
    counts = np.maximum(last - np.arange(len(order)) - 1, 0)
    ends = np.cumsum(counts)
    begin = 0
    while begin < len(order):
        done = ends[begin - 1] if begin else 0
        end = max(int(np.searchsorted(ends, done + MAX_PAIRS, side="right")), begin + 1)
        first = np.repeat(np.arange(begin, end), counts[begin:end])
        second = np.arange(len(first)) - np.repeat(ends[begin:end] - counts[begin:end] - done, counts[begin:end])
        second += first + 1
        for axis in (1, 2):
            hits = (low[second, axis] <= high[first, axis]) & (high[second, axis] >= low[first, axis])
            first, second = first[hits], second[hits]
        if len(first):
            yield order[first], order[second]
        begin = end


def touching(boxes: np.ndarray, box: np.ndarray) -> np.ndarray:
    """The numbers of the boxes (n, 2, 3) that touch a ``box`` (2, 3), in ascending order."""
    return np.flatnonzero(((boxes[:, 0] <= box[1]) & (boxes[:, 1] >= box[0])).all(axis=1))


def components(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Labels the connected components of n boxes that touch: for each box, the smallest number in its component."""
    label = np.arange(len(low))
    for first, second in sweep(low, high):
        while True:
            a, b = label[first], label[second]
            if (a == b).all():
                break
            np.minimum.at(label, np.maximum(a, b), np.minimum(a, b))
            while (label[label] != label).any():
                label = label[label]
        if not label.any():
            break  # all are connected
    return label
