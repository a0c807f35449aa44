"""The context of a translation: its document and options; the files that a scene uses; limits of single precision."""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..geometry.leaves import LARGEST
from ..geometry.mesh_files import mesh_file
from ..geometry.primitives import Primitive
from ..language.diagnostics import quote
from ..language.document import Document
from ..language.document import Path as ValuePath
from ..model import Scene
from ..nodes import Node, plain, values_in
from ..translation_options import Options


@dataclass(frozen=True)
class Context:
    """A document, the options of its translation, and the set of approximations that have been ``reported``.

    ``image_path`` converts the path of an image to its file name in the translation.
    """

    document: Document
    options: Options
    image_path: Callable[[Path], str]
    reported: set[str] = field(default_factory=set)

    @property
    def scene(self) -> Scene:
        """The scene of the document."""
        return self.document.scene

    @property
    def samples(self) -> int:
        """N: an image has N² samples per pixel."""
        return self.options.samples or self.scene.samples

    def approximate(self, reason: str, *path: str | int) -> None:
        """Warns of an approximation; each ``reason`` is reported only once."""
        if reason not in self.reported:
            self.reported.add(reason)
            self.document.warn(reason, *path)

    def read_mesh(self, name: str, *path: str | int) -> Primitive:
        """Returns the solid of a mesh file. Raises SceneError if the file may not be used, or has no closed mesh."""
        full = self.file_path("mesh", name, *path)
        try:
            if full.stat().st_size > MESH_LIMIT:
                raise ValueError(f"is larger than {MESH_LIMIT >> 20} MiB, the largest size of a mesh file")
            return mesh_file(full.read_bytes())
        except OSError as reason:
            problem = f"cannot be read: {reason.strerror or reason}"
        except ValueError as reason:
            problem = str(reason)
        raise self.document.error(f"the mesh {quote(name)} {problem}", *path)

    def image_filename(self, name: str, *path: str | int) -> str:
        """Returns the file name of an image in the translation.

        Raises SceneError if the file may not be used, or is not an image.
        """
        error, full = self.document.error, self.file_path("image", name, *path)
        try:
            valid = is_image(full)
        except OSError as reason:
            raise error(f"the image {quote(name)} cannot be read: {reason.strerror or reason}", *path) from None
        if not valid:
            raise error(f"{quote(name)} is not an image; expected one of {', '.join(SIGNATURES)} or TGA", *path)
        try:
            return self.image_path(full)
        except ValueError as reason:
            raise error(str(reason), *path) from None

    def file_path(self, kind: str, name: str, *path: str | int) -> Path:
        """Returns the path of a file of this ``kind``, "image" or "mesh". Raises SceneError if the file does not exist,
        or may not be used.

        The file must be in the scene's folder or below, if the option ``allow_outside`` is False.
        """
        if not name:
            article = "an" if kind == "image" else "a"
            raise self.document.error(f"this file name is empty; expected {article} {kind} file", *path)
        folder = Path(self.document.source.filename).parent
        try:
            full = Path(os.path.realpath(located(folder, name)))  # realpath also accepts circular links
            exists = full.is_file()
        except (OSError, ValueError) as error:  # the name is too long, or has invalid characters
            problem = f"is not a valid file name: {getattr(error, 'strerror', None) or error}"
        else:
            if not self.options.allow_outside and not full.is_relative_to(folder.resolve()):
                problem = "is outside the scene's folder; move it there, or use the option --allow-outside, "
                problem += "in Python allow_outside=True"
            elif exists:
                return full
            else:
                quotes = "; write a file name in double quotes, or without quotes" if name[0] == "'" else ""
                problem = f"does not exist in the scene's folder{quotes}"
        raise self.document.error(f"the {kind} {quote(name)} {problem}", *path)


#: The largest size of a mesh file in bytes; a file of 4,000,000 triangles is smaller.
MESH_LIMIT = 2**27


def check_single_precision(document: Document, node: Node, *path: str | int) -> Node:
    """Returns ``node`` unchanged; raises a SceneError about ``path`` if a number in it exceeds single precision."""
    for value in values_in(plain(node, np.asarray)):
        for number in () if isinstance(value, str) else np.ravel(value).tolist():
            if not abs(number) <= LARGEST:
                reason = f"this gives {number:g}, which is beyond Mitsuba's single precision; "
                raise document.error(f"{reason}expected less extreme numbers", *path)
    return node


#: Image format -> the possible first bytes of a file.
SIGNATURES: dict[str, tuple[bytes, ...]] = {
    "PNG": (b"\x89PNG\r\n\x1a\n",),
    "JPEG": (b"\xff\xd8",),
    "OpenEXR": (b"\x76\x2f\x31\x01",),
    "RGBE": (b"#?",),
    "PFM": (b"PF", b"Pf"),
    "PPM": (b"P6",),
    "BMP": (b"BM",),
}

#: The last bytes of a TGA file of version 2, the only version that Mitsuba reads.
TGA_FOOTER = b"TRUEVISION-XFILE.\0"


def is_image(path: Path) -> bool:
    """Whether a file has the first bytes (TGA: the last bytes) of an image format that Mitsuba reads. Raises
    OSError.
    """
    with path.open("rb") as file:
        head = file.read(8)
        file.seek(max(path.stat().st_size - len(TGA_FOOTER), 0))
        return file.read() == TGA_FOOTER or any(head.startswith(signature) for signature in SIGNATURES.values())


def located(folder: Path, name: str) -> Path:
    """Returns the path of the file that a scene in ``folder`` calls ``name``."""
    return folder / name.replace("\\", "/")


def images(document: Document) -> Iterator[tuple[str, ValuePath]]:
    """Yields the name of each image file that a scene uses, with the path of this value in the model."""
    scene = document.scene
    if scene.background.image is not None:
        yield scene.background.image, ("background", "image")
    for number, light in enumerate(scene.lights):
        if light.image is not None:
            yield light.image, ("lights", number, "image")
    for number, leaf in scene.leaves:
        for slot, texture in enumerate(leaf.textures):
            if texture is not None and texture.image is not None:
                yield texture.image, ("csg", number, "textures", slot)


def meshes(document: Document) -> dict[str, ValuePath]:
    """Returns the names of the mesh files that a scene uses, each with the path of this value in the model."""
    return {leaf.file: ("csg", number, "file") for number, leaf in document.scene.leaves if leaf.file is not None}
