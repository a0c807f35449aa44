"""What one translation leaves to the next one of a scene with the same solids, such as the next frame of a film."""

from collections.abc import Callable, Hashable
from weakref import WeakKeyDictionary

from .geometry import SurfaceMesh, Triangles
from .output import ply


class Kept:
    """The faces of the last tree that was evaluated, by the content of its solids, and their PLY files.

    What they look like is no part of the content. They take as much memory as they take while they are made. ``made``
    counts the trees that were evaluated.
    """

    def __init__(self) -> None:
        self.key: Hashable = None
        self.found: SurfaceMesh | None = None
        self.files: WeakKeyDictionary[Triangles, dict[bool, bytes | None]] = WeakKeyDictionary()
        self.made = 0

    def faces(self, key: Hashable, make: Callable[[], SurfaceMesh]) -> SurfaceMesh:
        """What ``make`` gives, or has given the last time for an equal ``key``."""
        if self.found is None or key != self.key:
            self.found = None  # before another takes its room
            self.key, self.found = key, make()
            self.made += 1
        return self.found

    def file(self, triangles: Triangles, with_uv: bool) -> bytes | None:
        """The PLY file of some of these surfaces; see :func:`.output.ply`."""
        known = self.files.setdefault(triangles, {})
        if with_uv not in known:
            known[with_uv] = ply(triangles, with_uv)
        return known[with_uv]
