"""A file in the place of another, all of it or nothing."""

import os
import secrets
from pathlib import Path

#: How the name of an unfinished file begins. It says nothing of what that becomes, so it is never too long where the
#: other is not.
PART = ".prosim-part-"


def replace(path: Path, content: bytes, folder: Path, mode: int | None = None) -> None:
    """Writes a file with ``content`` in ``folder``, which is on the disk of ``path``, and then puts it in its place.

    ``mode``: its permissions, if not those of any new file. Raises OSError; then nothing has changed.
    """
    part = folder / f"{PART}{secrets.token_hex(6)}"
    try:
        with open(part, "xb") as file:
            file.write(content)
        if mode is not None:
            part.chmod(mode)
        os.replace(part, path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
