"""Replaces files atomically."""

import errno
import os
import secrets
import stat
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

#: The prefix of the name of an unfinished file. It is short, so that the whole name is never too long.
PART = ".prosim-part-"


def replace(path: Path, content: bytes | memoryview | Callable[[Path], None], folder: Path | None = None) -> None:
    """Replaces the file ``path`` atomically; the file keeps its permissions. If ``path`` is a symbolic link, the link
    is replaced, and the file to which it leads stays unchanged.

    ``content`` is the new content as bytes, or a function that writes the new content to a given path and may be called
    twice. The new file is first written to ``folder``, where the caller can find and remove unfinished files. If
    ``folder`` is None or on another disk, the new file is first written to the folder of ``path``. Raises OSError if
    the file cannot be replaced; it is then unchanged.
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


def refuse_special(path: Path) -> None:
    """Raises OSError if ``path`` is a device or a pipe, because a replacement by a file would remove it."""
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise FileExistsError(errno.EEXIST, "this is a device or a pipe, not a file", str(path))
