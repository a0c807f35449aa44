"""Writes the files of a translation, which are the XML file ``STEM.xml`` and the meshes as binary PLY files in the
folder ``STEM-meshes``.

The file name of a mesh ends in the digest of the file's content. The content of a mesh file to which an XML file refers
never changes, even if a translation is killed, because another content has another file name. So simultaneous
translations do not conflict, and the last one removes the mesh files to which the XML file no longer refers. It removes
such a file only if the digest in the file name agrees with the content. It also removes the unfinished files of killed
translations, but no other files.
"""

import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from hashlib import blake2b
from pathlib import Path

import numpy as np

from .atomic_files import PART, create_folder, refuse_special, replace
from .geometry import Triangles
from .nodes import is_valid_in_xml


def ply_bytes(triangles: Triangles, with_uv: bool) -> bytes | None:
    """Returns the content of a binary PLY file with the ``triangles``, or None if all triangles are degenerate.

    A triangle is degenerate if two of its corners are equal in single precision; the file contains no degenerate
    triangles. If ``with_uv`` is True, the file contains texture coordinates.
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


#: Each XML file that a translation writes contains this comment.
MARK = "A translation from the scene language; the next one takes its place"
MESH = re.compile(r"surface_\d+_*-([0-9a-f]{16})\.ply")


class TranslationFiles:
    """The files of a translation to ``folder``: the XML file ``xml``, and the meshes in the folder ``mesh_folder``.

    ``meshes`` maps the file name of each mesh to its content.
    """

    def __init__(self, folder: Path, stem: str) -> None:
        self.folder, self.xml, self.mesh_folder = folder, folder / f"{stem}.xml", folder / f"{stem}-meshes"
        self.meshes: dict[str, bytes] = {}

    def store(self, name: str, content: bytes) -> str:
        """Stores the content of a mesh until :meth:`write` writes it to a file; returns the path by which the XML file
        refers to the mesh file.

        The name of the mesh file consists of ``name`` and the digest of the content.
        """
        file = f"{name}-{_digest(content)}.ply"
        self.meshes[file] = content
        return f"{self.mesh_folder.name}/{file}"

    def image_path(self, path: Path) -> str:
        """Returns the path by which the XML file refers to an image file: relative to the folder of the XML file if
        possible, or else absolute.

        Raises ValueError for a path that is not valid in XML.
        """
        try:
            relative = Path(os.path.relpath(path, self.folder.resolve())).as_posix()
        except ValueError:  # on another drive of Windows
            relative = path.resolve().as_posix()
        if not is_valid_in_xml(relative):
            raise ValueError(f"has the path {relative!r}, which is not valid in XML; expected printable characters")
        return relative

    def write(self, text: str) -> Path:
        """Writes the XML ``text`` and the meshes; returns the path of the XML file.

        The XML file is replaced after the meshes are written, so the mesh files that the XML file names always exist.
        Meshes of earlier translations are removed at the end, if no other translation is writing. Raises OSError if the
        files cannot be written, in particular FileExistsError if a file that no translation wrote has the path of a
        result; existing files are then unchanged.
        """
        _check_replaceable(self.xml, self.mesh_folder)
        writing = _writing(self.folder, self._remove_unused_meshes)
        with create_folder(self.folder), create_folder(self.mesh_folder), writing:
            for name, content in self.meshes.items():
                path = self.mesh_folder / name
                if path.is_symlink() or not path.is_file() or path.read_bytes() != content:
                    replace(path, content, self.mesh_folder)
            replace(self.xml, text.encode(), self.mesh_folder)
        return self.xml

    def _remove_unused_meshes(self) -> None:
        """Removes unfinished files, and the meshes of translations to which the XML file does not refer."""
        used = self.xml.read_text(encoding="utf-8") if self.xml.exists() else ""
        for path in self.mesh_folder.iterdir():
            if path.name not in used and path.is_file() and _is_from_translation(path):
                path.unlink(missing_ok=True)


def _digest(content: bytes) -> str:
    return blake2b(content, digest_size=8).hexdigest()


def _check_replaceable(xml: Path, mesh_folder: Path) -> None:
    """Raises OSError rather than replace what no translation (with MARK in its XML) wrote."""
    if xml.is_dir():
        raise IsADirectoryError(0, "the translation would replace this folder; move it, or choose another folder", xml)
    refuse_special(xml)
    if xml.exists() and MARK.encode() not in xml.read_bytes():
        raise FileExistsError(0, "this file is not a translation; move it, or choose another folder", xml)
    if mesh_folder.is_symlink() or (mesh_folder.exists() and not mesh_folder.is_dir()):
        raise FileExistsError(0, "the meshes would replace this; move it, or choose another folder", mesh_folder)


@contextmanager
def _writing(folder: Path, clean_up: Callable[[], None]) -> Iterator[None]:
    """Tells other translations, by a shared lock on ``folder``, that this one writes meshes to which no XML file refers
    yet. At the end, also after an error, calls ``clean_up`` if no other translation is writing.

    ``clean_up`` is not called on Windows, on file systems without locks, and without the permission to read the folder.
    The operating system removes the lock of a killed process.
    """
    if sys.platform == "win32":
        yield
        return
    import fcntl

    def clean_up_alone() -> None:
        """Calls ``clean_up`` if this translation can have the lock for itself."""
        with suppress(BlockingIOError):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            clean_up()

    with ExitStack() as stack:
        with suppress(OSError):
            descriptor = os.open(folder, os.O_RDONLY)
            stack.callback(os.close, descriptor)
            fcntl.flock(descriptor, fcntl.LOCK_SH)
            stack.callback(clean_up_alone)
        yield


def _is_from_translation(path: Path) -> bool:
    """Whether the name is that of an unfinished file, or contains the digest of the file's content."""
    match = MESH.fullmatch(path.name)
    return bool(path.name.startswith(PART) or (match and _digest(path.read_bytes()) == match[1]))
