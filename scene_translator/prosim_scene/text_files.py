"""Reads scene files, and replaces files atomically."""

import errno
import os
import secrets
import stat
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from .language.analysis import SIZE_LIMIT, too_large
from .language.diagnostics import AnyPath, SceneError

#: The prefix of an unfinished file's name; short, so that the name is never too long.
PART = ".prosim-part-"


def read(path: AnyPath) -> str:
    """The text of a scene file: UTF-8, UTF-16 with a byte order mark, or else Latin-1."""
    path = Path(path)
    try:
        if path.stat().st_size > SIZE_LIMIT:
            raise too_large(path)
        data = path.read_bytes()
    except OSError as error:
        raise SceneError(f"{path}: {error.strerror or error}", str(path)) from None
    try:
        text = data.decode("utf-16" if data.startswith((BOM_UTF16_LE, BOM_UTF16_BE)) else "utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    if "\0" in text[:2]:  # probably UTF-16 without a byte order mark
        raise SceneError(f"{path}: the text is not UTF-8; save it in that encoding", str(path))
    return text.replace("\r\n", "\n").replace("\r", "\n")


def rewrite(path: AnyPath, text: str) -> None:
    """Replaces the text of a scene file atomically.

    The file keeps its permissions; a symbolic link stays, and its target is rewritten. Raises SceneError if the file
    cannot be written; it is then unchanged.
    """
    try:
        os.stat(path)  # a missing file is an error
        replace(Path(path), text.encode("utf-8"))
    except OSError as error:
        raise SceneError(f"{path}: {error.strerror or error}; the file is unchanged", str(path)) from None


def replace(path: Path, content: bytes | memoryview | Callable[[Path], None], folder: Path | None = None) -> None:
    """Replaces the content of the file ``path``, or of a link's target, atomically; it keeps its permissions.

    ``content``: bytes, or a function that writes them to a path.
    The new file is written to ``folder`` first; to the folder of ``path`` if ``folder`` is None or on another disk, or
    if ``path`` is a link. Raises OSError; then nothing has changed.
    """
    if path.is_symlink():
        path, folder = Path(os.path.realpath(path)), None
    refuse_special(path)
    part = (folder or path.parent) / f"{PART}{secrets.token_hex(6)}"
    try:
        if callable(content):
            content(part)
        else:
            part.write_bytes(content)
        with suppress(OSError):  # no old file, or a file system without permissions
            part.chmod(stat.S_IMODE(path.stat().st_mode))
        os.replace(part, path)
    except BaseException as error:
        part.unlink(missing_ok=True)
        if folder is None or not isinstance(error, OSError) or error.errno != errno.EXDEV:
            raise
        replace(path, content)


def refuse_special(path: Path) -> None:
    """Raises OSError for a device or a pipe, which a replacement would remove."""
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise FileExistsError(errno.EEXIST, "this is a device or a pipe, not a file", str(path))
