"""What is alike, and computed together."""

from collections.abc import Hashable, Iterable
from typing import TypeVar

K = TypeVar("K", bound=Hashable)


def alike(keys: Iterable[K]) -> dict[K, list[int]]:
    """The numbers of equal keys, from 0, by the key."""
    groups: dict[K, list[int]] = {}
    for number, key in enumerate(keys):
        groups.setdefault(key, []).append(number)
    return groups
