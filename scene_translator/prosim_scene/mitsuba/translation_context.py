"""The context of a translation: its document and options; the files that a scene uses; limits of single precision."""

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from ..geometry.leaves import LARGEST
from ..geometry.mesh_files import mesh_file
from ..geometry.primitives import Primitive
from ..language.diagnostics import quote
from ..language.document import Document
from ..language.document import Path as ValuePath
from ..nodes import Node, plain, values_in
from ..translation_options import Options

T = TypeVar("T")


class Context:
    """A document, its ``scene``, and the options of its translation.

    An image of the scene has ``samples``² samples per pixel. ``image_path`` converts the path of an image file to its
    file name in the translation. ``reported`` is the set of approximations that have been reported.
    """

    def __init__(self, document: Document, options: Options, image_path: Callable[[Path], str]) -> None:
        self.document, self.scene, self.options = document, document.scene, options
        self.samples = options.samples or document.scene.samples
        self.image_path = image_path
        self.reported = set[str]()

    def approximate(self, reason: str, *path: str | int) -> None:
        """Warns of an approximation; each ``reason`` is reported only once."""
        if reason not in self.reported:
            self.reported.add(reason)
            self.document.warn(reason, *path)

    def read_mesh(self, name: str, *path: str | int) -> Primitive:
        """Returns the solid of a mesh file. Raises SceneError if the file may not be used, or has no closed mesh."""
        return self._read_file("mesh", _mesh, name, *path)

    def image(self, plugin: str, name: str, *path: str | int) -> Node:
        """Returns the dictionary of a ``plugin`` that shows an image.

        Raises SceneError if the file may not be used, or is not an image.
        """
        return {"type": plugin, "filename": self._read_file("image", self._image_filename, name, *path)}

    def _image_filename(self, path: Path) -> str:
        """Returns the file name of an image in the translation. Raises ValueError if the file is not an image."""
        if not is_image(path):
            raise ValueError(f"is not an image; expected one of {FORMATS}")
        return self.image_path(path)

    def _read_file(self, kind: str, read: Callable[[Path], T], name: str, *path: str | int) -> T:
        """Returns the result of ``read`` for the path of the file that a value in the scene names.

        ``kind`` is "image" or "mesh", ``name`` is the value, and ``path`` is the path of the value in the model. The
        file must be in the scene's folder or below, if the option ``allow_outside`` is False. Raises SceneError if the
        file may not be used or does not exist, and if ``read`` raises OSError or ValueError.
        """
        folder = Path(self.document.source.filename).parent
        try:
            if not name or "\0" in name:
                raise ValueError("is not a valid file name; expected the name of a file in the scene's folder")
            full = Path(os.path.realpath(located(folder, name)))  # realpath also accepts circular links
            if not self.options.allow_outside and not full.is_relative_to(folder.resolve()):
                reason = "is outside the scene's folder; move it there, or use the option --allow-outside, "
                raise ValueError(f"{reason}in Python allow_outside=True")
            if not full.is_file():
                quotes = "; write a file name in double quotes, or without quotes" if name.startswith("'") else ""
                raise ValueError(f"does not exist in the scene's folder{quotes}")
            return read(full)
        except OSError as error:
            problem = f"cannot be read: {error.strerror or error}"
        except ValueError as error:
            problem = str(error)
        raise self.document.error(f"the {kind} {quote(name)} {problem}", *path)


#: The largest size of a mesh file in bytes; a file of 4,000,000 triangles is smaller.
MESH_LIMIT = 2**27


def _mesh(path: Path) -> Primitive:
    """Reads a mesh file. Raises OSError or ValueError."""
    if path.stat().st_size > MESH_LIMIT:
        raise ValueError(f"is larger than {MESH_LIMIT >> 20} MiB, the largest size of a mesh file")
    return mesh_file(path.read_bytes())


def check_single_precision(document: Document, node: Node, *path: str | int) -> Node:
    """Returns ``node`` unchanged; raises a SceneError if a number in ``node`` exceeds single precision.

    ``path`` is the path, in the model, of the value from which ``node`` was made.
    """
    for value in values_in(plain(node, np.asarray)):
        for number in () if isinstance(value, str) else np.ravel(value).tolist():
            if not abs(number) <= LARGEST:
                reason = f"this gives {number:g}, which is beyond Mitsuba's single precision; "
                raise document.error(f"{reason}expected less extreme numbers", *path)
    return node


#: The names of the image formats that Mitsuba reads; the first bytes of a file in one of these formats, except TGA; the
#: last bytes of a TGA file of version 2, the only version that Mitsuba reads.
FORMATS = "PNG, JPEG, OpenEXR, RGBE, PFM, PPM, BMP or TGA"
SIGNATURE = re.compile(rb"\x89PNG\r\n\x1a\n|\xff\xd8|\x76\x2f\x31\x01|#\?|P[Ff]|P6|BM")
TGA_FOOTER = b"TRUEVISION-XFILE.\0"


def is_image(path: Path) -> bool:
    """Whether a file has the first bytes (TGA: the last bytes) of an image format that Mitsuba reads. Raises
    OSError.
    """
    with path.open("rb") as file:
        head = file.read(8)
        file.seek(max(path.stat().st_size - len(TGA_FOOTER), 0))
        return file.read() == TGA_FOOTER or SIGNATURE.match(head) is not None


def located(folder: Path, name: str) -> Path:
    """Returns the path of the file that a scene in ``folder`` calls ``name``."""
    return folder / name.replace("\\", "/")


def images(document: Document) -> list[tuple[str, ValuePath]]:
    """Lists the names of the image files that a scene uses, each with the path of this value in the model."""
    scene = document.scene
    names: dict[ValuePath, str | None] = {("background", "image"): scene.background.image}
    names |= {("lights", number, "image"): light.image for number, light in enumerate(scene.lights)}
    for number, leaf in scene.leaves:
        names |= {("csg", number, "textures", i): texture.image for i, texture in enumerate(leaf.textures) if texture}
    return [(name, path) for path, name in names.items() if name is not None]


def meshes(document: Document) -> dict[str, ValuePath]:
    """Returns the names of the mesh files that a scene uses, each with the path of this value in the model."""
    return {leaf.file: ("csg", number, "file") for number, leaf in document.scene.leaves if leaf.file is not None}
