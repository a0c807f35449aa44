"""Detects changes of a scene's files."""

from __future__ import annotations

import time
from collections.abc import Iterable
from contextlib import suppress
from itertools import chain, islice
from pathlib import Path
from time import perf_counter as clock

#: Minimum number of seconds between two checks of the files, and the maximum fraction of the time for checks.
INTERVAL, FRACTION = 0.02, 0.02

#: Maximum number of files and folders in the scene's folder and its subfolders that are watched while the scene cannot
#: be opened.
MAX_WATCHED_FILES = 1000

#: The identity of a file's content: inode, size and time of the last change; None for a missing file.
Stamp = tuple[int, ...] | None


def stamp(path: Path) -> Stamp:
    """Returns the inode, size and modification time of a file or folder; None if there is none."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return status.st_ino, status.st_size, status.st_mtime_ns


class SceneWatcher:
    """Detects changes of the scene file ``path`` and of the files that the scene uses, by checking all these files
    repeatedly.

    The class does not use the change notifications of the operating system, because these notifications fail for
    folders that are deleted and made again, and on some file systems.
    """

    def __init__(self, path: Path) -> None:
        self._scene, self._due = path, 0.0
        #: Watched file or folder -> its last known stamp.
        self.stamps = {path.absolute(): stamp(path)}

    def opened(self, files: Iterable[Path]) -> None:
        """Watches only the scene file and the ``files`` that the scene uses, from now on."""
        self._watch({path.absolute() for path in [self._scene, *files]})

    def failed(self) -> None:
        """Also watches the folder of the scene file, and the files and folders in it and in its subfolders, at most
        :data:`MAX_WATCHED_FILES`, because the user may repair the scene by adding or changing any of these files.

        Call this method when the scene cannot be opened. The files in subfolders of subfolders are not watched.
        """
        folder = self._scene.absolute().parent
        files = {*self.stamps, folder}
        with suppress(OSError):  # too many open files, for example
            files.update(islice(chain(folder.glob("*"), folder.glob("*/*")), MAX_WATCHED_FILES))
        self._watch(files)

    def _watch(self, files: set[Path]) -> None:
        """Watches these ``files``; those that were watched keep their last stamps, so that no change is missed."""
        self.stamps = {path: self.stamps[path] if path in self.stamps else stamp(path) for path in files}

    def changed(self) -> bool:
        """Returns whether a watched file was written, made, removed or renamed since this method last returned True.

        While a file is still being written, the result is False. The caller may call this method often, because the
        method reads the stamps of the files only from time to time, and returns False without a check at other times.
        """
        started = clock()
        if started < self._due:
            return False
        stamps = {path: stamp(path) for path in self.stamps}
        self._due = clock() + max(INTERVAL, (clock() - started) / FRACTION)
        if stamps == self.stamps:
            return False
        time.sleep(INTERVAL)
        if stamps != {path: stamp(path) for path in stamps}:
            return False  # a file is still being written
        self.stamps = stamps
        return True
