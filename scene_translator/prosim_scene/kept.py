"""What one translation leaves to the next one of a scene with the same solids, such as the next frame of a film."""

from collections.abc import Callable, Hashable

from .solids import Triangles
from .solids.triangles import Found
from .write.ply import ply


class Kept:
    """The surfaces of the last tree that was evaluated, by the content of its solids, and their PLY files.

    They take as much memory as they take while they are made. ``made`` counts the trees that were evaluated.
    """

    def __init__(self) -> None:
        self.key: Hashable = None
        self.found: Found | None = None
        self.files: dict[tuple[int, bool], bytes | None] = {}
        self.made = 0

    def surfaces(self, key: Hashable, make: Callable[[], Found]) -> Found:
        """What ``make`` gives, or has given the last time for an equal ``key``."""
        if self.found is None or key != self.key:
            self.found = None  # before another takes its room
            self.files.clear()
            self.key, self.found = key, make()
            self.made += 1
        return self.found

    def file(self, triangles: Triangles, with_uv: bool) -> bytes | None:
        """The PLY file of some of these surfaces; see :func:`.write.ply.ply`."""
        key = id(triangles), with_uv
        if key not in self.files:
            self.files[key] = ply(triangles, with_uv)
        return self.files[key]
