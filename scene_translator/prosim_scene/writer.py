"""The files of a translation: ``STEM.xml``, and its meshes as binary PLY files in ``STEM-meshes``.

A mesh's name ends in the digest of its content. So a mesh never changes while an XML file names it, also if a
translation is killed. Simultaneous translations of one scene write the same files. If the name of a file agrees with
its content, a translation wrote it, and the next one may remove it. No other file is removed.
"""

import os
import re
import sys
import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager, suppress
from hashlib import blake2b
from pathlib import Path

import numpy as np

from .geometry import SurfaceMesh, Triangles
from .text_files import PART, refuse_special, replace


def ply_bytes(triangles: Triangles, with_uv: bool) -> bytes | None:
    """The bytes of a PLY file; None if all triangles have no area in single precision.

    Triangles without area are left out.
    """
    vertices, index = triangles.vertices.astype("<f4"), triangles.index
    a, b, c = (vertices[index[:, i]] for i in range(3))
    proper = (a != b).any(1) & (b != c).any(1) & (c != a).any(1)
    if not proper.any():
        return None
    columns = [vertices, triangles.normals]
    names = ["x", "y", "z", "nx", "ny", "nz"]
    if with_uv:
        columns.append(triangles.uv)
        names += ["u", "v"]
    vertices = np.concatenate(columns, axis=1).astype("<f4")
    if not proper.all():
        used, index = np.unique(index[proper], return_inverse=True)
        vertices = vertices[used]
    faces = np.empty(int(proper.sum()), dtype=[("count", "u1"), ("index", "<i4", 3)])
    faces["count"], faces["index"] = 3, index.reshape(-1, 3)
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {name}" for name in names]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    return "\n".join(header).encode() + vertices.tobytes() + faces.tobytes()


class TranslationCache:
    """A translation cache: the surface of the last evaluated tree, with its cache key.

    The key does not depend on materials. The cache takes as much memory as the evaluation. ``evaluations`` counts the
    evaluated trees.
    """

    def __init__(self) -> None:
        self.key: Hashable = None
        self.surface: SurfaceMesh | None = None
        self.evaluations = 0

    @property
    def triangles(self) -> Triangles | None:
        """The triangles of the last evaluated tree; None if there are none."""
        return self.surface.triangles if self.surface and len(self.surface.triangles.vertices) else None

    def faces(self, key: Hashable, evaluate: Callable[[], SurfaceMesh]) -> SurfaceMesh:
        """The result of ``evaluate``, or the cached result if its ``key`` is equal."""
        if self.surface is None or key != self.key:
            self.surface = None  # frees memory before the evaluation
            self.key, self.surface = key, evaluate()
            self.evaluations += 1
        return self.surface


#: A comment in each XML file that a translation writes.
MARK = "A translation from the scene language; the next one takes its place"
LOCK_TIMEOUT = 10.0  # seconds, for another translation to the same folder
MESH = re.compile(r"surface_\d+_*-([0-9a-f]{16})\.ply")


def mesh_name(name: str, content: bytes) -> str:
    """The file name of a mesh: ``name`` and the digest of its content."""
    return f"{name}-{_digest(content)}.ply"


def meshes_folder(stem: str) -> str:
    """The name of the folder of the meshes."""
    return f"{stem}-meshes"


def write(folder: Path, stem: str, text: str, meshes: dict[str, bytes]) -> Path:
    """Writes the XML ``text`` and the ``meshes`` by their file names; returns the path of the XML.

    The XML is renamed into place last, so its meshes always exist. Meshes of earlier translations are removed. Raises
    OSError (FileExistsError if a user's file has that path); then nothing has changed.
    """
    xml, folder_of_meshes = folder / f"{stem}.xml", folder / meshes_folder(stem)
    _check_replaceable(xml, folder_of_meshes)
    folder.mkdir(parents=True, exist_ok=True)
    with _locked(folder) as locked:
        folder_of_meshes.mkdir(exist_ok=True)
        written: list[Path] = []
        try:
            for name, content in meshes.items():
                if not _has_content(folder_of_meshes / name, content):
                    replace(folder_of_meshes / name, content, folder_of_meshes)
                    written.append(folder_of_meshes / name)
            replace(xml, text.encode(), folder_of_meshes)
        except BaseException:
            for path in written:
                path.unlink(missing_ok=True)
            with suppress(OSError):  # it is not empty, or a link
                folder_of_meshes.rmdir()
            raise
        if locked:
            _remove_old_meshes(folder_of_meshes, meshes)
    return xml


def _digest(content: bytes) -> str:
    """The digest of a file's content, in hexadecimal digits."""
    return blake2b(content, digest_size=8).hexdigest()


def _check_replaceable(xml: Path, folder_of_meshes: Path) -> None:
    """Raises OSError if an existing file or folder is not a translation's."""
    if xml.is_dir():
        raise IsADirectoryError(0, "the translation would replace this folder; move it, or choose another folder", xml)
    refuse_special(xml)
    if xml.exists() and MARK.encode() not in xml.read_bytes():
        reason = "this file is not a translation and is not overwritten; move it, or choose another folder"
        raise FileExistsError(0, reason, xml)
    if os.path.lexists(folder_of_meshes) and not folder_of_meshes.is_dir():
        reason = "the folder of the meshes would replace this file or broken link; move it, or choose another folder"
        raise FileExistsError(0, reason, folder_of_meshes)


@contextmanager
def _locked(folder: Path) -> Iterator[bool]:
    """Locks a folder: another translation could remove the meshes of this one before its XML is written.

    Yields whether the lock is held. It is not on Windows, on some network file systems, and if the user may not read
    the folder. The system removes the lock of a killed process. Raises TimeoutError after LOCK_TIMEOUT seconds.
    """
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except PermissionError:  # on Windows for every folder
        yield False
        return
    end = time.monotonic() + LOCK_TIMEOUT
    try:
        while (locked := _lock(descriptor)) is None:
            if time.monotonic() > end:
                reason = "another translation is writing to this folder; wait for it, or choose another folder"
                raise TimeoutError(0, reason, folder)
            time.sleep(0.02)
        yield locked
    finally:
        os.close(descriptor)


def _lock(descriptor: int) -> bool | None:
    """Locks an open folder; returns whether the file system has locks, or None if another translation has the lock."""
    if sys.platform == "win32":
        return False
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return None
    except OSError:
        return False
    return True


def _has_content(path: Path, content: bytes) -> bool:
    """Whether the file at a path exists and has this content."""
    return path.is_file() and path.stat().st_size == len(content) and path.read_bytes() == content


def _remove_old_meshes(folder_of_meshes: Path, meshes: dict[str, bytes]) -> None:
    """Removes the meshes of earlier translations, and the unfinished files of killed ones."""
    for path in folder_of_meshes.iterdir():
        if path.name not in meshes and path.is_file() and _is_from_translation(path):
            path.unlink(missing_ok=True)


def _is_from_translation(path: Path) -> bool:
    """Whether a translation wrote this file: it is unfinished, or a mesh whose name agrees with its content."""
    match = MESH.fullmatch(path.name)
    return bool(path.name.startswith(PART) or (match and _digest(path.read_bytes()) == match[1]))
