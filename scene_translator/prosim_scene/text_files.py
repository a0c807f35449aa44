"""Reads and rewrites scene files."""

import os
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE
from pathlib import Path

from .atomic_files import replace
from .language.analysis import SIZE_LIMIT, too_large
from .language.diagnostics import AnyPath, SceneError

BYTE_ORDER_MARKS = BOM_UTF8, BOM_UTF16_LE, BOM_UTF16_BE


def read(path: AnyPath) -> str:
    """Reads the text of a scene file, as :func:`decode` does. Raises SceneError if the file cannot be read or is too
    large, and if it begins like a binary file, or like UTF-16 without a byte order mark.
    """
    path = Path(path)
    try:
        with open(path, "rb") as file:
            data = file.read(SIZE_LIMIT + 1)  # a device may have no end
        if len(data) > SIZE_LIMIT:
            raise too_large(path)
    except OSError as error:
        raise SceneError(error.strerror or str(error), path) from None
    text = decode(data)
    if "\0" in text[:16]:  # an image, for example, or UTF-16 without a byte order mark
        raise SceneError("this is not a text in UTF-8; give a scene, and save it as UTF-8", path)
    return text


def decode(data: bytes) -> str:
    """Decodes UTF-8, UTF-16 with a byte order mark, or else Latin-1; line ends become LF."""
    try:
        text = data.decode("utf-16" if data.startswith(BYTE_ORDER_MARKS[1:]) else "utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def rewrite(path: AnyPath, text: str) -> None:
    """Replaces the text of a scene file, which must exist, atomically; the new text is UTF-8.

    The file keeps its permissions. If ``path`` is a symbolic link, the target of the link is rewritten. Raises
    SceneError if the file cannot be written; the file is then unchanged.
    """
    try:
        os.stat(path)  # a missing file is an error
        replace(Path(os.path.realpath(path)), text.encode("utf-8"))
    except OSError as error:
        raise SceneError(f"{error.strerror or error}; the file is unchanged", path) from None
