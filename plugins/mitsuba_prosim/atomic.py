"""Files that are complete or absent, and temporary folders."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from prosim_scene import PART, refuse_special

#: How the names of temporary folders begin, and of folders for files that could not be written where they should.
SCRATCH, RESCUE = "prosim-scratch-", "prosim-image-"

#: The content of a file, or a function that writes it to a path.
Content = bytes | memoryview | Callable[[Path], None]

#: Unfinished files that are older than this, in seconds, belong to a killed process.
LEFTOVER = 24 * 3600


def check(paths: Iterable[Path], size: int) -> None:
    """Checks that files of ``size`` bytes in total could be written; leaves nothing behind.

    Raises OSError where a name is too long, a folder or a device is in the way, or a folder is read-only or full.
    """
    folders = set()
    for path in map(_target, paths):
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "this is a folder", str(path))
        folder = next(folder for folder in path.parents if os.path.lexists(folder) or folder == folder.parent)
        if not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, "this is not a folder", str(folder))
        for name in path.relative_to(folder).parts:
            with suppress(FileNotFoundError):
                os.lstat(folder / name)  # raises where the name is too long
        folders.add(folder)
    for folder in folders:
        try:
            with tempfile.TemporaryFile(dir=folder) as file:
                _allocate(file.fileno(), folder, size)
        except OSError as error:
            why = f"no file of {size} bytes can be written there: {error.strerror}"
            raise OSError(error.errno, why, str(folder)) from None


def _allocate(file: int, folder: Path, size: int) -> None:
    """Reserves ``size`` bytes in an open file. Raises OSError."""
    if hasattr(os, "posix_fallocate"):
        try:
            os.posix_fallocate(file, 0, size)
        except OSError as error:
            if error.errno not in (errno.EOPNOTSUPP, errno.EINVAL):
                raise
    elif shutil.disk_usage(folder).free < size:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def write(contents: Mapping[Path, Content]) -> list[Path]:
    """Writes files, makes their folders, and returns their paths. Existing files are replaced when all new ones are
    complete. They keep their modes; links stay links.

    Raises OSError; then no file is written, unless a renaming fails.
    """
    parts: dict[Path, Path] = {}
    try:
        for path, content in contents.items():
            target = _target(path)
            target.parent.mkdir(parents=True, exist_ok=True)
            remove_leftovers(target.parent)
            part = target.parent / (PART + secrets.token_hex(6))
            parts[part] = target
            if callable(content):
                content(part)
            else:
                part.write_bytes(content)
            with suppress(OSError):  # there is no old file, or the disk has no modes
                part.chmod(stat.S_IMODE(target.stat().st_mode))
        for part, target in parts.items():
            os.replace(part, target)
    finally:
        for part in parts:
            part.unlink(missing_ok=True)
    return list(contents)


def rescue(contents: Mapping[Path, Content]) -> list[Path]:
    """Writes files to a new folder on the first disk that has room; returns their paths. Raises OSError."""
    failures = []
    for place in (Path(tempfile.gettempdir()), Path.home(), Path.cwd(), Path("/dev/shm")):
        folder = place / (RESCUE + secrets.token_hex(4))
        try:
            return write({folder / path.name: content for path, content in contents.items()})
        except OSError as error:
            failures.append(error)
            with suppress(OSError):
                folder.rmdir()
    raise failures[0]


@contextmanager
def scratch() -> Iterator[Path]:
    """A temporary folder."""
    with tempfile.TemporaryDirectory(prefix=SCRATCH, ignore_cleanup_errors=True) as name:
        yield Path(name)


def remove_leftovers(folder: Path) -> None:
    """Removes the unfinished files of killed processes."""
    for part in folder.glob(PART + "*"):
        with suppress(OSError):
            if time.time() - part.stat().st_mtime > LEFTOVER:
                part.unlink()


def _target(path: Path) -> Path:
    """The file that ``path`` is or links to. Raises OSError for a device or a pipe."""
    target = Path(os.path.realpath(path)) if path.is_symlink() else path
    refuse_special(target)
    return target
