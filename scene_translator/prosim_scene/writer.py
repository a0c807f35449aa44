"""Writes the files of a translation: ``STEM.xml``, and its meshes as binary PLY files in the folder ``STEM-meshes``.

The file name of a mesh ends in the digest of the file's content. A mesh that an XML file names therefore never changes,
even if a translation is killed. Simultaneous translations of one scene write the same files. A translation removes a
mesh of an earlier translation if the digest in its name agrees with its content. No other files are removed.
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
from .nodes import is_valid_in_xml
from .text_files import PART, refuse_special, replace


def ply_bytes(triangles: Triangles, with_uv: bool) -> bytes | None:
    """Returns the content of a binary PLY file, or None if no triangle has an area in single precision.

    Triangles without area are left out. ``with_uv`` is True for a file with texture coordinates.
    """
    vertices, index = triangles.vertices.astype("<f4"), triangles.index
    a, b, c = (vertices[index[:, i]] for i in range(3))
    proper = (a != b).any(1) & (b != c).any(1) & (c != a).any(1)
    if not proper.any():
        return None
    names = ["x", "y", "z", "nx", "ny", "nz", "u", "v"][: 8 if with_uv else 6]
    columns = np.concatenate([vertices, triangles.normals, triangles.uv], axis=1)
    vertices = columns[:, : len(names)].astype("<f4")
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
    """A translation cache: the surface of the CSG tree that was evaluated last, with its cache key.

    The key does not depend on materials. The cache needs as much memory as the evaluation of the CSG tree.
    ``evaluations`` is the number of trees that were evaluated.
    """

    def __init__(self) -> None:
        self.key: Hashable = None
        self.surface: SurfaceMesh | None = None
        self.evaluations = 0

    def surface_for(self, key: Hashable, evaluate: Callable[[], SurfaceMesh]) -> SurfaceMesh:
        """Returns the cached surface if its key equals ``key``; otherwise caches and returns ``evaluate()``."""
        if self.surface is None or key != self.key:
            self.surface = None  # frees memory before the evaluation
            self.key, self.surface = key, evaluate()
            self.evaluations += 1
        return self.surface


#: Each XML file that a translation writes contains this comment.
MARK = "A translation from the scene language; the next one takes its place"
LOCK_TIMEOUT = 10.0  # how many seconds to wait for another translation to the same folder
MESH = re.compile(r"surface_\d+_*-([0-9a-f]{16})\.ply")


class TranslationFiles:
    """The files of a translation to ``folder``: the XML file ``xml``, and the meshes in the folder ``mesh_folder``.

    ``meshes`` maps the file name of each mesh to its content.
    """

    def __init__(self, folder: Path, stem: str) -> None:
        self.folder, self.xml, self.mesh_folder = folder, folder / f"{stem}.xml", folder / f"{stem}-meshes"
        self.meshes: dict[str, bytes] = {}

    def store(self, name: str, content: bytes) -> str:
        """Keeps the content of a mesh until all files are written; returns the path of the mesh for the XML file.

        The file name of the mesh is ``name`` and the digest of the content.
        """
        file = f"{name}-{_digest(content)}.ply"
        self.meshes[file] = content
        return f"{self.mesh_folder.name}/{file}"

    def image_path(self, path: Path) -> str:
        """Returns the path of an image for the XML file, relative to the folder of the XML file if possible.

        Raises ValueError for a path that is not valid in XML.
        """
        try:
            relative = Path(os.path.relpath(path, self.folder.resolve())).as_posix()
        except ValueError:  # on another drive of Windows
            relative = path.resolve().as_posix()
        if not is_valid_in_xml(relative):
            reason = f"has the path {relative!r}, which is not valid in XML; expected printable characters, in UTF-8"
            raise ValueError(reason)
        return relative

    def write(self, text: str) -> Path:
        """Writes the XML ``text`` and the meshes; returns the path of the XML file.

        The XML file is replaced last, so the meshes that it names always exist. Meshes of earlier translations are
        removed. Raises OSError, or FileExistsError if a file of the user has the path of a result; no file has changed
        then.
        """
        _check_replaceable(self.xml, self.mesh_folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        with _locked(self.folder) as locked:
            self.mesh_folder.mkdir(exist_ok=True)
            written: list[Path] = []
            try:
                for name, content in self.meshes.items():
                    path = self.mesh_folder / name
                    if not _has_content(path, content):
                        replace(path, content, self.mesh_folder)
                        written.append(path)
                replace(self.xml, text.encode(), self.mesh_folder)
            except BaseException:
                for path in written:
                    path.unlink(missing_ok=True)
                with suppress(OSError):  # the folder is not empty, or is a link
                    self.mesh_folder.rmdir()
                raise
            if locked:
                _remove_old_meshes(self.mesh_folder, self.meshes)
        return self.xml


def _digest(content: bytes) -> str:
    """Returns the digest of a file's content, in hexadecimal digits."""
    return blake2b(content, digest_size=8).hexdigest()


def _check_replaceable(xml: Path, mesh_folder: Path) -> None:
    """Raises OSError if an existing file or folder was not written by a translation."""
    if xml.is_dir():
        raise IsADirectoryError(0, "the translation would replace this folder; move it, or choose another folder", xml)
    refuse_special(xml)
    if xml.exists() and MARK.encode() not in xml.read_bytes():
        reason = "this file is not a translation and is not overwritten; move it, or choose another folder"
        raise FileExistsError(0, reason, xml)
    if os.path.lexists(mesh_folder) and not mesh_folder.is_dir():
        reason = "the folder of the meshes would replace this file or broken link; move it, or choose another folder"
        raise FileExistsError(0, reason, mesh_folder)


@contextmanager
def _locked(folder: Path) -> Iterator[bool]:
    """Locks a folder, so that no other translation removes the new meshes before the new XML file names them.

    Yields whether the folder is locked. Locks do not exist on Windows and on some network file systems, and need the
    permission to read the folder. The operating system removes the lock of a killed process. Raises TimeoutError after
    LOCK_TIMEOUT seconds.
    """
    if sys.platform == "win32":
        yield False
        return
    import fcntl

    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except PermissionError:
        yield False
        return
    end, locked = time.monotonic() + LOCK_TIMEOUT, False
    try:
        while not locked:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                locked = True
            except BlockingIOError:
                if time.monotonic() > end:
                    reason = "another translation is writing to this folder; wait for it, or choose another folder"
                    raise TimeoutError(0, reason, folder) from None
                time.sleep(0.02)
            except OSError:  # the file system has no locks
                break
        yield locked
    finally:
        os.close(descriptor)


def _has_content(path: Path, content: bytes) -> bool:
    """Whether a file with this path and this content exists."""
    return path.is_file() and path.stat().st_size == len(content) and path.read_bytes() == content


def _remove_old_meshes(mesh_folder: Path, meshes: dict[str, bytes]) -> None:
    """Removes the meshes of earlier translations, and the unfinished files of translations that were killed."""
    for path in mesh_folder.iterdir():
        if path.name not in meshes and path.is_file() and _is_from_translation(path):
            path.unlink(missing_ok=True)


def _is_from_translation(path: Path) -> bool:
    """Whether a translation wrote this file: it is unfinished, or its name contains the digest of its content."""
    match = MESH.fullmatch(path.name)
    return bool(path.name.startswith(PART) or (match and _digest(path.read_bytes()) == match[1]))
