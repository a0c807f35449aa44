"""Files that are complete or not there, and folders that do not stay when their process is killed."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from prosim_scene import PART, refuse_special

if sys.platform != "win32":  # where nobody can remove a file that is open: that is its lock
    import fcntl

#: How the names begin of folders for a while, and of those of what could not be written where it should.
SCRATCH, RESCUE = "prosim-scratch-", "prosim-image-"

#: The file in a scratch folder that is locked as long as the folder is in use.
LOCK = ".lock"

#: What is written: the content of a file, or what writes it to a path, over what is there.
Content = bytes | memoryview | Callable[[Path], None]

#: What is younger, in seconds, is not taken for a leftover: it may not have been locked yet.
YOUNG = 60


def check(paths: Iterable[Path], size: int) -> None:
    """Sees, before the work, whether files of ``size`` bytes in all could be written; nothing is left behind.

    Raises OSError where a name is too long, a folder or a device stands in the way, or a folder can't be
    written to or has no room.
    """
    folders = set()
    for path in paths:
        folder = _existing(path.parent)
        if not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, "this is no folder", str(folder))
        longest = os.pathconf(folder, "PC_NAME_MAX") if hasattr(os, "pathconf") else 255
        for name in path.relative_to(folder).parts:
            if len(os.fsencode(name)) > longest:
                raise OSError(errno.ENAMETOOLONG, f"this name is too long, at most {longest} bytes are allowed", name)
        target = _target(path)
        if target.is_dir():
            raise IsADirectoryError(errno.EISDIR, "this is a folder", str(target))
        folders.add(_existing(target.parent))
    for folder in folders:
        try:
            with _Parts() as parts:
                _allocate(parts.new(folder), size)
        except OSError as error:
            # the folder is there: it is the system's own, such as /proc
            why = "it takes no new files" if error.errno == errno.ENOENT else error.strerror
            raise OSError(error.errno, f"no file of {size} bytes can be written there: {why}", str(folder)) from None


def write(contents: Mapping[Path, Content]) -> list[Path]:
    """Writes files, and makes their folders; returns their paths. They take the old ones' places when all are complete,
    keep their modes, and go where they are links to.

    Raises OSError; then none of them is written, unless the last step, the renaming, fails between two.
    """
    with _Parts() as parts:
        for path, content in contents.items():
            target = _target(path)
            target.parent.mkdir(parents=True, exist_ok=True)
            part = parts.new(target.parent)
            if callable(content):
                content(part)
            else:
                part.write_bytes(content)
            with suppress(OSError):  # there is no old one, or no mode on such a disk
                os.chmod(part, stat.S_IMODE(os.stat(target).st_mode))
            parts.finished[part] = target
        for part, target in parts.finished.items():
            parts.unlock(part)
            os.replace(part, target)
    return list(contents)


def rescue(contents: Mapping[Path, Content]) -> list[Path]:
    """Writes files that :func:`write` could not to a new folder wherever there is room; returns their paths.

    Raises OSError if that is nowhere.
    """
    failure: OSError | None = None
    for place in (Path(tempfile.gettempdir()), Path.home(), Path.cwd(), Path("/dev/shm")):
        folder = None
        try:
            folder = Path(tempfile.mkdtemp(prefix=RESCUE, dir=place))
            return write({folder / path.name: content for path, content in contents.items()})
        except OSError as error:
            failure = failure or error
            if folder is not None:
                shutil.rmtree(folder, ignore_errors=True)
    assert failure is not None
    raise failure


@contextmanager
def scratch() -> Iterator[Path]:
    """A new folder for a while. What a killed process has left of its own is removed first."""
    place = Path(tempfile.gettempdir())
    for folder in place.glob(SCRATCH + "*"):
        _remove_leftover(folder)
    with (
        tempfile.TemporaryDirectory(prefix=SCRATCH, dir=place, ignore_cleanup_errors=True) as name,
        _locked(Path(name, LOCK)),
    ):
        yield Path(name)


def _target(path: Path) -> Path:
    """The file itself, where ``path`` is a link. Raises OSError where a device or a pipe would be replaced."""
    target = Path(os.path.realpath(path)) if path.is_symlink() else path
    refuse_special(target)
    return target


def _existing(folder: Path) -> Path:
    """The folder, or the nearest one above it that is there."""
    while not os.path.lexists(folder):
        folder = folder.parent
    return folder


def _allocate(path: Path, size: int) -> None:
    """Takes room for ``size`` bytes in a file, as far as the system lets a program do that."""
    if hasattr(os, "posix_fallocate"):
        with open(path, "r+b") as file:
            try:
                os.posix_fallocate(file.fileno(), 0, size)
            except OSError as error:
                if error.errno not in (errno.EOPNOTSUPP, errno.EINVAL):
                    raise
    elif shutil.disk_usage(path.parent).free < size:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


class _Parts:
    """Unfinished files, locked as long as this context lasts; what has not been renamed by then is removed."""

    def __init__(self):
        self.made: dict[Path, ExitStack] = {}
        self.finished: dict[Path, Path] = {}

    def __enter__(self) -> _Parts:
        return self

    def new(self, folder: Path) -> Path:
        """The path of a new part in a folder, from which leftovers are removed first."""
        for part in folder.glob(PART + "*"):
            _remove_leftover(part)
        part = folder / (PART + secrets.token_hex(6))
        self.made[part] = lock = ExitStack()
        lock.enter_context(_locked(part))
        return part

    def unlock(self, part: Path) -> None:
        """Lets it be renamed or removed, which Windows refuses for an open file. It stays young for a minute."""
        with suppress(OSError):
            os.utime(part)
        self.made[part].close()

    def __exit__(self, *_: object) -> None:
        for part in self.made:
            self.unlock(part)
            part.unlink(missing_ok=True)


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """A new file that says that it, or its folder, is in use, as long as this context lasts. Where no lock can be had,
    leftovers stay.
    """
    with open(path, "xb") as file:
        if sys.platform != "win32":
            with suppress(OSError):
                fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _remove_leftover(path: Path) -> None:
    """Removes a part or a scratch folder of ours, if nobody has locked it and it is not new."""
    with suppress(OSError):
        found = path.lstat()
        ours = not hasattr(os, "getuid") or found.st_uid == os.getuid()
        if not ours or time.time() - found.st_mtime < YOUNG:
            return
        if stat.S_ISDIR(found.st_mode):
            _remove_unlocked(path / LOCK)
            shutil.rmtree(path)
        else:
            _remove_unlocked(path)


def _remove_unlocked(path: Path) -> None:
    """Removes a file, if it is there. Raises OSError where somebody has locked it."""
    with suppress(FileNotFoundError), ExitStack() as until:
        if sys.platform != "win32":
            fcntl.flock(until.enter_context(open(path, "rb")), fcntl.LOCK_EX | fcntl.LOCK_NB)
        path.unlink()
