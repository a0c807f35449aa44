"""A file in the place of another, all of it or nothing."""

import errno
import os
import secrets
import stat
from contextlib import suppress
from pathlib import Path

#: How the name of an unfinished file begins. It says nothing of what that becomes, so it is never too long where the
#: other is not.
PART = ".prosim-part-"


def replace(path: Path, content: bytes, folder: Path | None = None) -> None:
    """Replaces the file ``path``, or what this link leads to, by one with ``content`` and the same permissions.

    The new file is written to ``folder`` first, or beside ``path``: by default, for a link, and where ``folder`` is on
    another disk. Raises OSError; then nothing has changed.
    """
    if path.is_symlink():
        path, folder = Path(os.path.realpath(path)), None
    refuse_special(path)
    part = (folder or path.parent) / f"{PART}{secrets.token_hex(6)}"
    try:
        with open(part, "xb") as file:
            file.write(content)
        with suppress(OSError):  # there is no old one, or no mode on such a disk
            part.chmod(stat.S_IMODE(path.stat().st_mode))
        os.replace(part, path)
    except BaseException as error:
        part.unlink(missing_ok=True)
        if folder is None or not isinstance(error, OSError) or error.errno != errno.EXDEV:
            raise
        replace(path, content)


def refuse_special(path: Path) -> None:
    """Raises OSError where there is something that is neither a file nor a folder: a file in its place would be no
    device any more, for nobody.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise FileExistsError(errno.EEXIST, "this is a device or a pipe, not a file", str(path))
