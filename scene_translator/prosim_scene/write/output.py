"""The files of a translation: ``STEM.xml``, and its meshes in ``STEM-meshes``.

A mesh's name ends in the digest of its content. So a mesh never changes under the XML that names it, whatever is killed
when; translations of the same scene at the same time write the same files; and a file whose name agrees with its
content is one that a translation wrote, and may be removed by the next one. Nothing else ever is.
"""

import os
import re
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from hashlib import blake2b
from pathlib import Path

from ..files import PART, refuse_special, replace

if sys.platform != "win32":
    import fcntl

#: Stands in each XML file that a translation writes.
MARK = "A translation from the scene language; the next one takes its place"
WAIT = 10.0  # seconds, for another translation to the same folder
MESH = re.compile(r"surface_\d+_*-([0-9a-f]{16})\.ply")


def mesh_name(name: str, content: bytes) -> str:
    """The file name of a mesh."""
    return f"{name}-{_digest(content)}.ply"


def meshes_folder(stem: str) -> str:
    """The name of the folder of the meshes."""
    return f"{stem}-meshes"


def write(folder: Path, stem: str, text: str, meshes: dict[str, bytes]) -> Path:
    """Writes the XML ``text`` and the ``meshes`` by their file names; returns the path of the XML.

    The XML comes last, by renaming: it never stands without its meshes. Meshes of earlier translations are removed.
    Raises OSError, FileExistsError among them where a file of the user's is in the way; then nothing has changed.
    """
    xml, bodies = folder / f"{stem}.xml", folder / meshes_folder(stem)
    _make_sure_of(xml, bodies)
    with _alone_in(bodies) as alone:
        written: list[Path] = []
        try:
            for name, content in meshes.items():
                if not _holds(bodies / name, content):
                    replace(bodies / name, content, bodies)
                    written.append(bodies / name)
            replace(xml, text.encode(), bodies)
        except BaseException:
            for path in written:
                path.unlink(missing_ok=True)
            with suppress(OSError):  # it is not empty, or a link
                bodies.rmdir()
            raise
        if alone:
            _tidy(bodies, meshes)
    return xml


def _digest(content: bytes) -> str:
    return blake2b(content, digest_size=8).hexdigest()


def _make_sure_of(xml: Path, bodies: Path) -> None:
    """Raises where what is there already is not a translation's."""
    if xml.is_dir():
        raise IsADirectoryError(
            0, "this folder stands where the translation goes; move it, or choose another folder", xml
        )
    refuse_special(xml)
    if xml.exists() and MARK.encode() not in xml.read_bytes():
        raise FileExistsError(
            0, "this file is no translation and is not overwritten; move it, or choose another folder", xml
        )
    if os.path.lexists(bodies) and not bodies.is_dir():
        raise FileExistsError(
            0,
            "this file, or link to nowhere, stands where the folder of the meshes goes; move it, or choose another "
            "folder",
            bodies,
        )


@contextmanager
def _alone_in(folder: Path) -> Iterator[bool]:
    """Makes the folder, and keeps other translations out of it as long as the context lasts: else one could remove the
    meshes of another before the XML that names them is there. Raises TimeoutError after WAIT seconds.

    Returns whether that can be done: not on Windows, nor in every network's file system. The lock is the folder's own,
    so that nothing is left behind where a translation is killed.
    """
    end = time.monotonic() + WAIT
    while True:
        folder.mkdir(parents=True, exist_ok=True)
        if sys.platform == "win32":
            yield False
            return
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            alone = _locked(descriptor, folder, end)
            try:
                if not os.path.samestat(os.fstat(descriptor), os.stat(folder)):
                    continue  # it was removed, and perhaps made again, in the meantime
            except FileNotFoundError:
                continue
            yield alone
            return
        finally:
            os.close(descriptor)


def _locked(descriptor: int, folder: Path, end: float) -> bool:
    """Locks a folder; False where it cannot be locked. Raises TimeoutError after the time ``end``."""
    while sys.platform != "win32":
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except BlockingIOError:
            if time.monotonic() > end:
                raise TimeoutError(
                    0, "another translation is writing to this folder; wait for it, or choose another folder", folder
                ) from None
            time.sleep(0.02)
        except OSError:
            break
    return False


def _holds(path: Path, content: bytes) -> bool:
    return path.is_file() and path.stat().st_size == len(content) and path.read_bytes() == content


def _tidy(bodies: Path, meshes: dict[str, bytes]) -> None:
    """Removes the meshes of earlier translations, and what those that were killed left unfinished."""
    for path in bodies.iterdir():
        if path.name not in meshes and path.is_file() and _ours(path):
            path.unlink(missing_ok=True)


def _ours(path: Path) -> bool:
    match = MESH.fullmatch(path.name)
    return bool(path.name.startswith(PART) or (match and _digest(path.read_bytes()) == match[1]))
