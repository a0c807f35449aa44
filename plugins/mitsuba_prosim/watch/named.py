"""The files that a scene names: those that it is made of, and those that it can't be opened without."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path

from ..scene import errors
from .changes import stamp

#: What is quoted, as its second group; the apostrophe of "the scene's" is no quote.
QUOTED = re.compile(r"""(?<!\w)(["'])([^\n\0]+?)\1(?!\w)""")

#: No file has a name of so many characters.
LONGEST = 256


def places(path: Path) -> set[Path]:
    """Where a file lies, and where that which it may be a link to does; of links that lead to each other, one."""
    return {path.absolute(), Path(os.path.realpath(path))}


def spoken_of(words: str, scene: Path) -> frozenset[Path]:
    """Where the files are to be that the ``words`` of an error have in quotes, or in which they name a place, as the
    text of ``scene`` names them.
    """
    names = [found[2] for found in QUOTED.finditer(words)] + errors.files(words)
    names = [name for name in names if len(name) < LONGEST and "\0" not in name]
    if scene.suffix.lower() != ".xml":  # what a translation names so is its own
        names = [name for name in names if not Path(name).is_absolute()]
    return frozenset(place for name in names for place in places(scene.parent / name))


class Files:
    """The files that the scene at ``path`` is made of, as far as they are known; its methods may be called by any
    thread.
    """

    def __init__(self, path: Path) -> None:
        self._scene = path
        self._known, self._missing = frozenset(places(path)), frozenset[Path]()

    def known(self) -> frozenset[Path]:
        """All of them, those too that a scene which can't be opened speaks of."""
        return self._known

    def missing(self) -> frozenset[Path]:
        """Those that were not there when the scene was to be opened."""
        return self._missing

    def opened(self, files: Iterable[Path]) -> None:
        """The scene was opened, and is made of ``files``, wherever they lie."""
        self._known = frozenset(place for path in [self._scene, *files] for place in places(path))
        self._missing = frozenset()

    def failed(self, words: str) -> None:
        """The scene can't be opened; ``words`` say why."""
        files = spoken_of(words, self._scene)
        self._missing = frozenset(path for path in files if stamp(path) is None)
        self._known |= files
