"""Notices changes of a scene's files."""

from __future__ import annotations

import time
from collections.abc import Iterable
from itertools import chain, islice
from pathlib import Path
from time import perf_counter as clock

#: Minimum number of seconds between two polls, and the maximum share of the time that they take.
INTERVAL, SHARE = 0.02, 0.02

#: Maximum number of files in the scene's folder that are watched while the scene cannot be opened.
MAX_WATCHED_FILES = 1000

#: Differs after a file was written; None for a missing file.
Stamp = tuple[int, ...] | None


def stamp(path: Path) -> Stamp:
    """The stamp of a file or folder."""
    try:
        found = path.stat()
    except (OSError, ValueError):
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns


class SceneWatcher:
    """Watches the files of the scene at ``path``. It polls: the system notifies about folders, which are removed and
    made again, and on some disks it does not.
    """

    def __init__(self, path: Path) -> None:
        self._scene, self._due = path, 0.0
        self._stamps = {path.absolute(): stamp(path)}

    @property
    def files(self) -> frozenset[Path]:
        """The watched files and folders."""
        return frozenset(self._stamps)

    def opened(self, files: Iterable[Path]) -> None:
        """Watches the scene and ``files``, which it uses."""
        self._watch({path.absolute() for path in [self._scene, *files]})

    def failed(self) -> None:
        """Also watches the scene's folder and its subfolders, because one of their files may be missing or wrong."""
        folder = self._scene.absolute().parent
        self._watch({*self._stamps, folder, *islice(chain(folder.glob("*"), folder.glob("*/*")), MAX_WATCHED_FILES)})

    def _watch(self, files: set[Path]) -> None:
        self._stamps = {path: self._stamps[path] if path in self._stamps else stamp(path) for path in files}

    def changed(self) -> bool:
        """Whether any was written, made, removed or renamed since this was true, and stays the same for a moment. Call
        it often.
        """
        started = clock()
        if started < self._due:
            return False
        found = {path: stamp(path) for path in self._stamps}
        self._due = clock() + max(INTERVAL, (clock() - started) / SHARE)
        if found == self._stamps:
            return False
        time.sleep(INTERVAL)
        if found != {path: stamp(path) for path in found}:
            return False  # it is being written
        self._stamps = found
        return True
