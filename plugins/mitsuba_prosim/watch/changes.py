"""When files are saved."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

import watchfiles

#: Milliseconds without a further change after which those that there were are told, and within which they are.
QUIET, LONGEST = 20, 200

#: Milliseconds after which it is looked again which files there are to watch.
AGAIN = 500

#: What is another after a file was written; None where there is none.
Stamps = dict[Path, tuple[int, ...] | None]


@contextmanager
def watched(
    files: Callable[[], Collection[Path]], tell: Callable[[], None], missing: Callable[[], Collection[Path]] = frozenset
) -> Iterator[None]:
    """Calls ``tell``, in a thread, whenever one of ``files``, absolute paths, is written, made, removed or renamed.
    ``missing``: those of them that were not there when they were looked for, and may have been made since.

    Their folders are watched, not the files: many editors save a new file and rename it.
    """
    end = threading.Event()
    thread = threading.Thread(target=_follow, args=(files, tell, missing, end), name="changes", daemon=True)
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join(2)


def _follow(
    files: Callable[[], Collection[Path]],
    tell: Callable[[], None],
    missing: Callable[[], Collection[Path]],
    end: threading.Event,
) -> None:
    known: Stamps = {}
    while not end.is_set():
        folders = folders_of(files())
        if not folders:
            end.wait(AGAIN / 1000)
            continue
        try:
            known = _until_others(folders, files, tell, missing, end, known)
        except FileNotFoundError:
            continue  # a folder has gone


def _until_others(
    folders: set[Path],
    files: Callable[[], Collection[Path]],
    tell: Callable[[], None],
    missing: Callable[[], Collection[Path]],
    end: threading.Event,
    known: Stamps,
) -> Stamps:
    """Watches ``folders`` until there are others to watch; returns the stamps of ``files`` then."""
    for found in watchfiles.watch(
        *folders,
        watch_filter=None,
        debounce=LONGEST,
        step=QUIET,
        rust_timeout=AGAIN,
        yield_on_timeout=True,
        stop_event=end,
        recursive=False,
        raise_interrupt=False,
    ):
        # What changes between two watches is seen by its stamp.
        now = {path: stamp(path) for path in files()}
        known = dict.fromkeys(missing()) | known
        changed = any(path in known and known[path] != stamped for path, stamped in now.items())
        known = now
        if changed or {Path(path) for _, path in found} & set(now):
            tell()
        if folders_of(files()) != folders:
            break
    return known


def folders_of(files: Collection[Path]) -> set[Path]:
    """The folders of files, as far as they are there."""
    return {path.parent for path in files if os.path.isdir(path.parent)}  # False for a name too long, too


def stamp(path: Path) -> tuple[int, ...] | None:
    """What is another after a file was written; None where there is no file."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns
