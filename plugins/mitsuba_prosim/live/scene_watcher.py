"""Detects changes of a scene's files."""

import time
from collections.abc import Iterable
from contextlib import suppress
from itertools import chain, islice
from pathlib import Path
from time import perf_counter as clock

#: Minimum number of seconds between two checks of the files, and the maximum fraction of the time for checks.
INTERVAL, FRACTION = 0.02, 0.02

#: Maximum number of files and folders in the scene's folder and its subfolders that are watched while the scene cannot
#: be opened, the least deep ones first; and how deep the subfolders are.
MAX_WATCHED_FILES, DEPTH = 1000, 5

#: The identity of a file's content: inode, size and time of the last change; None for a missing file.
Stamp = tuple[int, ...] | None


def stamp(path: Path) -> Stamp:
    """Returns the stamp of a file or folder, which changes when it is written; None if ``path`` does not exist."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return status.st_ino, status.st_size, status.st_mtime_ns


class SceneWatcher:
    """Detects changes of the scene file ``path`` and of the files that the scene uses.

    It checks the files repeatedly, because the notifications of the operating system fail for folders that are made
    again, and on some file systems.
    """

    def __init__(self, path: Path) -> None:
        self._scene, self._due = path, 0.0
        #: Watched file or folder -> its last known stamp.
        self.stamps = {path.absolute(): stamp(path)}

    def opened(self, files: Iterable[Path]) -> None:
        """Watches only the scene file and the ``files`` that the scene uses, after the scene was opened."""
        self._watch({path.absolute() for path in [self._scene, *files]})

    def failed(self) -> None:
        """Also watches the files in the scene's folder and its subfolders, at most :data:`MAX_WATCHED_FILES`, because
        the user may repair the scene by any of them.
        """
        folder = self._scene.absolute().parent
        files = {*self.stamps, folder}
        with suppress(OSError):  # too many open files, for example
            levels = (folder.glob("/".join("*" * depth)) for depth in range(1, DEPTH + 1))
            files.update(islice(chain.from_iterable(levels), MAX_WATCHED_FILES))
        self._watch(files)

    def _watch(self, files: set[Path]) -> None:
        """Watches these ``files`` and no others; known files keep their stamps, so that no change is missed."""
        self.stamps = {path: self.stamps[path] if path in self.stamps else stamp(path) for path in files}

    def changed(self) -> bool:
        """Returns whether a watched file has changed since this method last returned True, and is complete.

        The caller may call this method often, because the files are checked only from time to time.
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
