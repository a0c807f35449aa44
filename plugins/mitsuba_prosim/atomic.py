"""Writes files so that each file is either complete or absent; creates temporary folders."""

import errno
import os
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from prosim_scene import create_folder, guard, refuse_special, replace

#: Prefixes of the names of temporary folders, of folders for unfinished files, and of folders for files that could not
#: be written to their own place.
SCRATCH, UNFINISHED, RESCUE = "prosim-scratch-", ".prosim-part-", "prosim-image-"

#: The content of a file, or a function that writes the content to a path.
Content = bytes | memoryview | Callable[[Path], None]


def check(paths: Iterable[Path], size: int) -> None:
    """Raises OSError unless the files ``paths``, with ``size`` bytes in total, can be written: if a name is too long, a
    folder or a device has the name, a link leads to no folder, a folder is read-only, or a disk is full.
    """
    for path in paths:
        with suppress(FileNotFoundError):
            path.lstat()  # raises where a name is too long, or a file is in the place of a folder
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "this is a folder", str(path))
        refuse_special(path)
        # Missing folders will be created in this one.
        folder = next(folder for folder in path.parents if os.path.lexists(folder))
        if not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, "this is a link that leads to no folder", str(folder))
        try:
            tempfile.TemporaryFile(dir=folder).close()
            if shutil.disk_usage(folder).free < size:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            why = f"no file of {size} bytes can be written there: {error.strerror}"
            raise OSError(error.errno, why, str(folder)) from None


def write(contents: Mapping[Path, Content]) -> list[Path]:
    """Writes files, creates their folders, and returns the paths of the files.

    A file is replaced only when the new one is complete, and keeps its access permissions; a symbolic link is replaced
    by the file. A killed process leaves no unfinished file. Raises OSError if a file cannot be written; this file and
    the later ones stay unchanged, the earlier ones are written.
    """
    folders = {path: path.absolute().with_name(UNFINISHED + secrets.token_hex(6)) for path in contents}
    with guard(folders.values()):
        for path, content in contents.items():
            with create_folder(folders[path].parent), temporary(folders[path]):
                replace(path, content, folders[path])
    return list(contents)


def rescue(contents: Mapping[Path, Content]) -> list[Path]:
    """Writes files to a new folder in the temporary folder, the home folder, the current folder or ``/dev/shm``, the
    first where all can be written, and returns their paths. Raises OSError if there is none.
    """
    failures = []
    for place in map(Path, (tempfile.gettempdir(), os.path.expanduser("~"), ".", "/dev/shm")):
        folder = place / (RESCUE + secrets.token_hex(4))
        try:
            return write({folder / path.name: content for path, content in contents.items()})
        except OSError as error:
            failures.append(error)
            shutil.rmtree(folder, ignore_errors=True)
    raise failures[0]


@contextmanager
def scratch() -> Iterator[Path]:
    """Creates a temporary folder for the ``with`` block. A small process deletes it if this one is killed."""
    path = Path(tempfile.gettempdir(), SCRATCH + secrets.token_hex(8))
    with guard([path]), temporary(path):
        yield path


@contextmanager
def temporary(path: Path) -> Iterator[None]:
    """Creates the folder ``path`` for this user only, and deletes it at the end of the ``with`` block."""
    path.mkdir(mode=0o700)
    try:
        yield
    finally:
        shutil.rmtree(path, ignore_errors=True)
