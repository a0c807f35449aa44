"""The files of a scene, and their changes."""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter as clock

from ..scene import errors

#: Seconds between two polls, at least, and the share of the time that they may take.
EVERY, SHARE = 0.02, 0.02

#: The text within quotes, as its second group; the apostrophe of "the scene's" is no quote.
QUOTED = re.compile(r"""(?<!\w)(["'])([^\n\0]+?)\1(?!\w)""")

#: Longer texts are no names of files.
LONGEST = 256

#: Differs after a file was written; None where there is no file.
Stamp = tuple[int, ...] | None


def stamp(path: Path) -> Stamp:
    """The stamp of a file."""
    try:
        found = path.stat()
    except (OSError, ValueError):
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns


class Files:
    """The files of the scene at ``path``. Any thread may use it."""

    def __init__(self, path: Path) -> None:
        self._scene, self._lock = path, threading.Lock()
        self._stamps = {place: stamp(place) for place in places(path)}

    @property
    def known(self) -> frozenset[Path]:
        """All of them, also those that the error of a scene names which can't be opened."""
        return frozenset(self._stamps)

    def opened(self, files: Iterable[Path]) -> None:
        """The scene was opened, and uses ``files``."""
        self._set({place for path in [self._scene, *files] for place in places(path)})

    def failed(self, words: str) -> None:
        """The scene can't be opened; ``words`` are the error."""
        self._set({*self._stamps, *named(words, self._scene)})

    def _set(self, files: set[Path]) -> None:
        with self._lock:
            self._stamps = {path: self._stamps[path] if path in self._stamps else stamp(path) for path in files}

    def changed(self) -> bool:
        """Whether any was written, made, removed or renamed since the last look."""
        with self._lock:
            before, self._stamps = self._stamps, {path: stamp(path) for path in self._stamps}
            return before != self._stamps

    @contextmanager
    def watched(self, tell: Callable[[], None]) -> Iterator[None]:
        """Calls ``tell``, in a thread, after each change, when the files stay the same. It polls: notifications of the
        system are for folders, which come and go, and some disks have none.
        """
        end = threading.Event()

        def look() -> None:
            every = waiting = 0.0
            while not end.wait(max(EVERY, every)):
                started = clock()
                changed = self.changed()
                every = (clock() - started) / SHARE
                if waiting and not changed:
                    tell()
                waiting = changed

        thread = threading.Thread(target=look, name="files", daemon=True)
        thread.start()
        try:
            yield
        finally:
            end.set()
            thread.join(2)


def places(path: Path) -> set[Path]:
    """The paths of a file: its own, and that of the file that it links to."""
    return {path.absolute(), Path(os.path.realpath(path))}


def named(words: str, scene: Path) -> set[Path]:
    """Places of the files that the ``words`` of an error name in quotes, or as the place of an error, as the text of
    ``scene`` names them.
    """
    names = [found[2] for found in QUOTED.finditer(words)] + errors.files(words)
    names = [name for name in names if len(name) < LONGEST and "\0" not in name]
    if scene.suffix.lower() != ".xml":  # an absolute path is that of a translation
        names = [name for name in names if not Path(name).is_absolute()]
    return {place for name in names for place in places(scene.parent / name)}
