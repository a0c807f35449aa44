"""Scene files: how they are read."""

from os import PathLike
from pathlib import Path

from .messages import SceneError

#: Larger files are refused: a scene of 10,000 primitives has about 2 MiB.
SIZE_LIMIT = 16 * 2**20


def read(path: str | PathLike[str]) -> str:
    """The text of a scene file: UTF-8, or Latin-1 where it is not valid UTF-8."""
    path = Path(path)
    try:
        if path.stat().st_size > SIZE_LIMIT:
            raise too_large(path)
        data = path.read_bytes()
    except OSError as error:
        raise SceneError(f"{path}: {error.strerror or error}", str(path)) from None
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def too_large(path: str | PathLike[str]) -> SceneError:
    """The error about a scene beyond :data:`SIZE_LIMIT`."""
    return SceneError(f"{path}: the file is larger than {SIZE_LIMIT >> 20} MiB, the most that a scene may have", str(path))
