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
from html import escape
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from .geometry import SurfaceMesh, Triangles
from .nodes import Comment, Default, Node, Point
from .text_files import PART, refuse_special, replace


def ply(triangles: Triangles, with_uv: bool) -> bytes | None:
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
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(vertices)}",
        *(f"property float {name}" for name in names),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
        "",
    ]
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

    def faces(self, key: Hashable, make: Callable[[], SurfaceMesh]) -> SurfaceMesh:
        """The result of ``make``, or the cached one if its ``key`` is equal."""
        if self.surface is None or key != self.key:
            self.surface = None  # frees memory before the evaluation
            self.key, self.surface = key, make()
            self.evaluations += 1
        return self.surface


INDENT = "    "
INVALID_IN_XML = re.compile("[\x00-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")

#: The element of each plugin that the translator uses.
TAGS = {
    plugin: tag
    for tag, plugins in {
        "integrator": "prosim path volpath",
        "sensor": "perspective prosim_window",
        "film": "hdrfilm",
        "sampler": "nrook multijitter",
        "rfilter": "box",
        "shape": "ply sphere",
        "medium": "homogeneous",
        "emitter": "prosim_area prosim_point area point spot constant envmap",
        "texture": "bitmap prosim_brick prosim_stripes prosim_fractal prosim_product",
        "bsdf": "prosim_conductor prosim_dielectric prosim_lambertian prosim_composite prosim_phong diffuse conductor "
        "roughconductor dielectric roughdielectric plastic roughplastic blendbsdf",
    }.items()
    for plugin in plugins.split()
}


def plain(node: Node, transform: Callable[[np.ndarray], Any]) -> Node:
    """The dictionary for ``mi.load_dict``: without comments, with values of defaults and converted matrices."""

    def value(v: Any) -> Any:
        if isinstance(v, dict):
            return plain(v, transform)
        return v.value if isinstance(v, Default) else transform(v) if isinstance(v, np.ndarray) else v

    return {key: value(v) for key, v in node.items() if not isinstance(v, Comment)}


def xml(scene: Node) -> str:
    """The XML text of a scene."""
    root = ElementTree.Element("scene", version="3.0.0")
    for default in {d.name: d for d in _defaults(scene)}.values():
        ElementTree.SubElement(root, "default", name=default.name, value=number(default.value))
    statements = []  # positions of the comments that begin them
    for key, value in scene.items():
        if isinstance(value, Comment):
            statements.append(len(root))
        if key != "type":
            _entry(root, key, value, 1)
    ElementTree.indent(root, INDENT)
    for i in statements:  # a blank line before each
        if i:
            root[i - 1].tail = f"\n{root[i - 1].tail}"
        else:
            root.text = f"\n{root.text}"
    # ElementTree writes "<a />", and character references for line ends in a matrix.
    text = ElementTree.tostring(root, encoding="unicode").replace(" />", "/>").replace("&#10;", "\n")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n'


def is_valid_in_xml(text: str) -> bool:
    """Whether a name is valid in XML: it has no control characters, and no bytes that are not UTF-8."""
    return not INVALID_IN_XML.search(text)


def number(value: float) -> str:
    """Ten digits, more than Mitsuba's single precision keeps."""
    return format(value, ".10g")


def _defaults(node: Node) -> Iterator[Default]:
    for value in node.values():
        if isinstance(value, Default):
            yield value
        elif isinstance(value, dict):
            yield from _defaults(value)


def _entry(parent: ElementTree.Element, key: str, value: Any, depth: int) -> None:
    """Adds a parameter, a plugin or a comment to ``parent``, whose children are indented ``depth`` times."""
    if isinstance(value, Comment):
        text = escape(INVALID_IN_XML.sub("?", value), quote=False).replace("--", "- -")
        parent.append(ElementTree.Comment(f" {text} "))
    elif isinstance(value, dict):
        _element(parent, key, value, depth)
    else:
        _property(parent, key, value, depth)


def _element(parent: ElementTree.Element, key: str, node: Node, depth: int) -> None:
    if node["type"] == "rgb":
        ElementTree.SubElement(parent, "rgb", name=key, value=", ".join(map(number, node["value"])))
        return
    element = ElementTree.SubElement(parent, TAGS[node["type"]], type=node["type"])
    # An object in the scene has an id, a nested texture the name of a parameter.
    if parent.tag == "scene":
        element.set("id", key)
    elif element.tag in ("texture", "bsdf", "medium"):
        element.set("name", key)
    for name, value in node.items():
        if name != "type":
            _entry(element, name, value, depth + 1)


def _property(parent: ElementTree.Element, name: str, value: Any, depth: int) -> None:
    if isinstance(value, np.ndarray):
        transform = ElementTree.SubElement(parent, "transform", name=name)
        # One row per line.
        indent = "\n" + INDENT * (depth + 1) + " " * len('<matrix value="')
        ElementTree.SubElement(transform, "matrix", value=indent.join("  ".join(map(number, row)) for row in value))
        return
    if isinstance(value, list | tuple):
        x, y, z = map(number, value)
        ElementTree.SubElement(parent, "point" if isinstance(value, Point) else "vector", name=name, x=x, y=y, z=z)
        return
    kind, text = _scalar(value)
    ElementTree.SubElement(parent, kind, name=name, value=text)


def _scalar(value: Any) -> tuple[str, str]:
    if isinstance(value, Default):
        return _scalar(value.value)[0], f"${value.name}"
    if isinstance(value, bool):
        return "boolean", str(value).lower()
    if isinstance(value, int):
        return "integer", str(value)
    return ("float", number(value)) if isinstance(value, float) else ("string", value.replace("$", "\\$"))


if sys.platform != "win32":
    import fcntl

#: A comment in each XML file that a translation writes.
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

    The XML is renamed into place last, so its meshes always exist. Meshes of earlier translations are removed. Raises
    OSError (FileExistsError if a user's file has that path); then nothing has changed.
    """
    xml, folder_of_meshes = folder / f"{stem}.xml", folder / meshes_folder(stem)
    _check_replaceable(xml, folder_of_meshes)
    with _locked(folder_of_meshes) as locked:
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
    return blake2b(content, digest_size=8).hexdigest()


def _check_replaceable(xml: Path, folder_of_meshes: Path) -> None:
    """Raises OSError if an existing file or folder is not a translation's."""
    if xml.is_dir():
        raise IsADirectoryError(0, "the translation would replace this folder; move it, or choose another folder", xml)
    refuse_special(xml)
    if xml.exists() and MARK.encode() not in xml.read_bytes():
        raise FileExistsError(
            0, "this file is not a translation and is not overwritten; move it, or choose another folder", xml
        )
    if os.path.lexists(folder_of_meshes) and not folder_of_meshes.is_dir():
        raise FileExistsError(
            0,
            "the folder of the meshes would replace this file or broken link; move it, or choose another folder",
            folder_of_meshes,
        )


@contextmanager
def _locked(folder: Path) -> Iterator[bool]:
    """Makes the folder and locks it against other translations, which could remove meshes before their XML is written.

    Yields whether the lock is held: Windows and some network file systems have none. The system removes the lock of a
    killed process. Raises TimeoutError after WAIT seconds.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    end = time.monotonic() + WAIT
    while True:
        with suppress(FileExistsError):
            folder.mkdir()  # in each turn: another translation that failed may have removed it
        if sys.platform == "win32":
            yield False
            return
        try:
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        except FileNotFoundError:
            if time.monotonic() > end:
                raise
            continue
        try:
            locked = _lock(descriptor, folder)
            if locked is not None:
                yield locked
                return
        finally:
            os.close(descriptor)
        if time.monotonic() > end:
            raise TimeoutError(
                0, "another translation is writing to this folder; wait for it, or choose another folder", folder
            )
        time.sleep(0.02)


def _lock(descriptor: int, folder: Path) -> bool | None:
    """Whether an open folder could be locked; None if another translation has the lock, or has removed the folder."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return None
    except OSError:
        return False
    try:
        return os.path.samestat(os.fstat(descriptor), os.stat(folder)) or None
    except FileNotFoundError:
        return None


def _has_content(path: Path, content: bytes) -> bool:
    return path.is_file() and path.stat().st_size == len(content) and path.read_bytes() == content


def _remove_old_meshes(folder_of_meshes: Path, meshes: dict[str, bytes]) -> None:
    """Removes the meshes of earlier translations, and the unfinished files of killed ones."""
    for path in folder_of_meshes.iterdir():
        if path.name not in meshes and path.is_file() and _is_from_translation(path):
            path.unlink(missing_ok=True)


def _is_from_translation(path: Path) -> bool:
    match = MESH.fullmatch(path.name)
    return bool(path.name.startswith(PART) or (match and _digest(path.read_bytes()) == match[1]))
