"""Results of operations on meshes, kept from one evaluation of a tree to the next one by what they come from.

What an operation comes to follows from its operands, down to the leaves. So a part has a *digest*, of its leaf or of
its operation and the digests of the operands: where the tree has changed at one place, whatever does not come from
there is found again. Operands of what is found need not even be made.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

from manifold3d import Manifold

T = TypeVar("T")
TRIANGLES = 1 << 20  # kept at most, each of some 200 bytes


class Results:
    """Results of the last evaluation, by the digest of what they come from, and those of the present one.

    At most TRIANGLES of one evaluation are kept, the first ones.
    """

    def __init__(self) -> None:
        self._last: dict[bytes, Any] = {}
        self._now: dict[bytes, Any] = {}
        self._triangles = 0  # of _now
        self._ids = range(0)

    def begin(self, leaves: int) -> int:
        """Another evaluation begins: the original id of its first leaf, the same one as the last time if possible."""
        self._last, self._now, self._triangles = self._now, {}, 0
        if leaves > len(self._ids):
            count = 1 << leaves.bit_length()
            first = int(Manifold.reserve_ids(count))
            self._ids, self._last = range(first, first + count), {}
        return self._ids.start

    def end(self) -> None:
        """The evaluation has ended: what it had no use for is forgotten."""
        self._last = {}

    def found(self, digest: bytes, make: Callable[[], T], triangles: Callable[[T], int]) -> T:
        """The result with this digest, or what ``make`` gives, which has so many triangles."""
        if digest in self._now:
            known: T = self._now[digest]
            return known
        result: T = self._last.pop(digest) if digest in self._last else make()
        if self._triangles + (more := triangles(result)) <= TRIANGLES:
            self._triangles += more
            self._now[digest] = result
        return result


@dataclass(frozen=True)
class Content:
    """What a part comes from, all that it follows from as bytes, and where results are kept."""

    bytes_of: Callable[[], Iterable[bytes]]
    results: Results

    @cached_property
    def digest(self) -> bytes:
        """Of these bytes, and where each part of them ends."""
        result = hashlib.blake2b(digest_size=16)
        for part in self.bytes_of():
            result.update(len(part).to_bytes(8, "little") + part)
        return result.digest()

    @staticmethod
    def combined(operation: str, contents: Iterable[Content | None]) -> Content | None:
        """Of the result of an operation on parts; None where one of them is not known by its content."""
        known: list[Content] = []
        for one in contents:
            if one is None:
                return None
            known.append(one)
        return Content(lambda: [operation.encode(), *(one.digest for one in known)], known[0].results)


def kept(content: Content | None, kind: str, make: Callable[[], T], triangles: Callable[[T], int]) -> T:
    """What ``make`` gives, or has given for the same content and kind of result."""
    return make() if content is None else content.results.found(kind.encode() + content.digest, make, triangles)
