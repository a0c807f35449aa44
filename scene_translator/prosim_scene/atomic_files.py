"""Replaces files atomically; creates temporary folders that no end of the process leaves behind."""

import errno
import os
import secrets
import shutil
import stat
import tempfile
import weakref
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from subprocess import DEVNULL, PIPE, Popen

#: The prefix of the name of an unfinished file. It is short, so that the whole name is never too long.
PART = ".prosim-part-"


def replace(path: Path, content: bytes | memoryview | Callable[[Path], None], folder: Path | None = None) -> None:
    """Replaces the file ``path`` atomically, with its permissions; a link is replaced, not what it leads to.

    ``content`` is bytes, or a function that writes to a given path, perhaps twice. The new file is first written to
    ``folder``, if it is on the same disk, else beside ``path``. Raises OSError; the file is then unchanged.
    """
    refuse_special(path)
    part = (folder or path.parent) / f"{PART}{secrets.token_hex(6)}"
    try:
        if callable(content):
            content(part)
        else:
            part.write_bytes(content)
        with suppress(OSError):  # no old file, or a file system without permissions
            if not path.is_symlink():
                part.chmod(stat.S_IMODE(path.stat().st_mode))
        os.replace(part, path)
    except BaseException as error:
        part.unlink(missing_ok=True)
        if folder is None or not isinstance(error, OSError) or error.errno != errno.EXDEV:
            raise
        replace(path, content)


@contextmanager
def create_folder(folder: Path) -> Iterator[None]:
    """Creates ``folder`` and its parents. If the ``with`` block raises an error, removes those of them that are new and
    empty. Raises OSError.
    """
    new = [one for one in (folder, *folder.parents) if not one.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        with suppress(OSError):  # one is not empty, or was not created
            for one in new:
                if one.exists():
                    one.rmdir()
        raise


def refuse_special(path: Path) -> None:
    """Raises OSError if ``path`` is a device or a pipe."""
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise FileExistsError(errno.EEXIST, "this is a device or a pipe, not a file", str(path))


class TemporaryFolder:
    """A folder for this user only, removed with the last reference to it or at the end of the process."""

    def __init__(self) -> None:
        self.path = Path(tempfile.gettempdir(), f"prosim-scene-{secrets.token_hex(8)}")
        with ExitStack() as stack:
            stack.enter_context(guard([self.path]))
            self.path.mkdir(mode=0o700)
            stack.callback(shutil.rmtree, self.path, ignore_errors=True)
            weakref.finalize(self, stack.pop_all().close)


@contextmanager
def guard(folders: Iterable[Path]) -> Iterator[None]:
    """Starts a process that deletes ``folders`` if this process ends inside the ``with`` block, by any signal.

    The process is not started on Windows, or if the limit of processes is reached.
    """
    # The standard input of the process ends when this process ends. The new session has no Ctrl-C.
    command = ["/bin/sh", "-c", 'read line || rm -rf -- "$@"', "sh", *map(str, folders)]
    with ExitStack() as stack:
        with suppress(OSError):
            process = Popen(command, stdin=PIPE, stdout=DEVNULL, stderr=DEVNULL, cwd="/", start_new_session=True)
            stack.callback(process.communicate, b"\n")
        yield
