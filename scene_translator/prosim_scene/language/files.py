"""Scene files: how they are read, and written anew."""

import os
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from os import PathLike
from pathlib import Path

from ..replacing import replace
from .messages import SceneError

#: Larger files are refused: a scene of 10,000 primitives has about 2 MiB.
SIZE_LIMIT = 16 * 2**20


def read(path: str | PathLike[str]) -> str:
    """The text of a scene file: UTF-8, UTF-16 where it begins with that encoding's mark, or else Latin-1."""
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
    if "\0" in text[:2]:  # every other byte of what is most likely UTF-16 without its mark
        raise SceneError(f"{path}: this is no text in UTF-8; expected it saved in that encoding", str(path))
    return text.replace("\r\n", "\n").replace("\r", "\n")


def rewrite(path: str | PathLike[str], text: str) -> None:
    """Puts ``text`` in the place of a scene file's own, all of it or nothing.

    The file keeps its permissions, and a symbolic link stays one: what it leads to is rewritten. Raises SceneError
    where that cannot be done; the file is then as it was.
    """
    try:
        os.stat(path)  # one that is gone is not made
        replace(Path(path), text.encode("utf-8"))
    except OSError as error:
        raise SceneError(f"{path}: {error.strerror or error}; the file is as it was", str(path)) from None


def too_large(path: str | PathLike[str]) -> SceneError:
    """The error about a scene beyond :data:`SIZE_LIMIT`."""
    return SceneError(
        f"{path}: the file is larger than {SIZE_LIMIT >> 20} MiB, the most that a scene may have", str(path)
    )
