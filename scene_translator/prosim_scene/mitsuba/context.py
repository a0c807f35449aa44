"""What the functions of a target know of the translation; files; single precision, which is Mitsuba's."""

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..geometry.mesh_files import mesh_file
from ..geometry.primitives import Primitive
from ..geometry.transforms import matrices
from ..language.diagnostics import quote
from ..language.document import Document
from ..language.document import Path as Way
from ..model import Leaf, Scene
from ..nodes import Default, Node


@dataclass(frozen=True)
class Context:
    """A document on its way to Mitsuba: the options that the targets ask for, and what has been said so far.

    ``folder`` is that of the scene, where its images are; ``image_path`` makes of such an image's path what stands in
    the result.
    """

    document: Document
    folder: Path
    light_units: str
    samples: int
    allow_outside: bool
    image_path: Callable[[Path], str]
    said: set[str] = field(default_factory=set)

    @property
    def scene(self) -> Scene:
        """The scene itself."""
        return self.document.scene

    def approximate(self, reason: str, *path: str | int) -> None:
        """Says once, by a SceneWarning, what could not be said exactly."""
        if reason not in self.said:
            self.said.add(reason)
            self.document.warn(reason, *path)

    def mesh(self, name: str, *path: str | int) -> Primitive:
        """The solid in a file, which has to lie in the scene's folder or below."""
        full = self.file("mesh", name, *path)
        try:
            if full.stat().st_size > MESH_LIMIT:
                raise ValueError(f"is larger than {MESH_LIMIT >> 20} MiB, the most that a mesh may have")
            return mesh_file(full.read_bytes())
        except OSError as reason:
            what = f"cannot be read: {reason.strerror or reason}"
        except ValueError as reason:
            what = str(reason)
        raise self.document.error(f"the mesh {quote(name)} {what}", *path)

    def image(self, name: str, *path: str | int) -> str:
        """What stands in the result for an image file, which has to lie in the scene's folder or below."""
        error, full = self.document.error, self.file("image", name, *path)
        try:
            picture = is_picture(full)
        except OSError as reason:
            raise error(f"the image {quote(name)} cannot be read: {reason.strerror or reason}", *path) from None
        if not picture:
            raise error(f"{quote(name)} is no image; expected one of {', '.join(BEGINNINGS)} or TGA", *path)
        try:
            return self.image_path(full)
        except ValueError as reason:
            raise error(str(reason), *path) from None

    def file(self, what: str, name: str, *path: str | int) -> Path:
        """Where a file is, an image or a mesh, as ``what`` says; it has to lie in the scene's folder or below."""
        error = self.document.error
        if not name:
            raise error(
                f"this file name is empty; expected {'an image file' if what == 'image' else 'a mesh file'}", *path
            )
        try:
            full = Path(os.path.realpath(located(self.folder, name)))  # links may lead in a circle
            exists = full.is_file()
        except (OSError, ValueError) as reason:  # too long, or characters that no file name can have
            raise error(
                f"the {what} {quote(name)} cannot be a file: {getattr(reason, 'strerror', None) or reason}", *path
            ) from None
        if not self.allow_outside and not full.is_relative_to(self.folder.resolve()):
            raise error(
                f"the {what} {quote(name)} lies outside the scene's folder; expected a path in it, or the option that "
                "allows others: --allow-outside, allow_outside=True in Python",
                *path,
            )
        if not exists:
            marks = "; a file's name stands in double quotes, or in none" if name[0] == "'" else ""
            raise error(f"the {what} {quote(name)} does not exist in the scene's folder{marks}", *path)
        return full


#: The most bytes of a mesh's file: 4,000,000 triangles have fewer.
MESH_LIMIT = 2**27
#: The largest number whose square single precision still holds.
LARGEST = 1e19


def check(document: Document, node: Node, *path: str | int) -> Node:
    """The node itself, if Mitsuba can hold its numbers; a SceneError about what stands at ``path`` if not."""
    for value in _numbers(node):
        if not abs(value) <= LARGEST:
            raise document.error(
                f"this comes to {value:g}, which is beyond single precision, Mitsuba's; expected less extreme numbers",
                *path,
            )
    return node


def check_transforms(document: Document) -> None:
    """Raises the SceneError about a transform that leads beyond single precision."""
    transforms = document.scene.transforms
    if not transforms:
        return
    with np.errstate(all="ignore"):
        found = matrices(list(transforms.values()))
    wrong = ~(np.abs(found).max(axis=(1, 2)) <= LARGEST)
    narrowest = np.linalg.svd(np.where(wrong[:, None, None], 0, found)[:, :3, :3], compute_uv=False).min(axis=1)
    for index, beyond in zip(transforms, (wrong | (narrowest < 1 / LARGEST)).tolist()):
        if beyond:
            raise document.error(
                "these steps together lead beyond single precision, Mitsuba's; expected less extreme factors "
                "and distances",
                "transforms",
                index,
            )


def _numbers(value: Any) -> Iterable[float]:
    if isinstance(value, dict):
        for part in value.values():
            yield from _numbers(part)
    elif isinstance(value, Default):
        yield value.value
    elif isinstance(value, np.ndarray | list | tuple):
        yield from np.ravel(value).tolist()
    elif isinstance(value, int | float):
        yield value


#: What a file begins with, by format.
BEGINNINGS: dict[str, tuple[bytes, ...]] = {
    "PNG": (b"\x89PNG\r\n\x1a\n",),
    "JPEG": (b"\xff\xd8",),
    "OpenEXR": (b"\x76\x2f\x31\x01",),
    "RGBE": (b"#?",),
    "PFM": (b"PF", b"Pf"),
    "PPM": (b"P6",),
    "BMP": (b"BM",),
}

#: What a TGA file ends with, of version 2, the only one that Mitsuba knows.
TGA = b"TRUEVISION-XFILE.\0"


def is_picture(path: Path) -> bool:
    """Whether ``path`` is a picture of some format that Mitsuba reads. Raises OSError where it can't be read."""
    with path.open("rb") as file:
        head = file.read(8)
        file.seek(max(path.stat().st_size - len(TGA), 0))
        return file.read() == TGA or any(head.startswith(beginning) for beginning in BEGINNINGS.values())


def located(folder: Path, name: str) -> Path:
    """Where a scene in ``folder`` has the image that it names so."""
    return folder / name.replace("\\", "/")


def images(document: Document) -> Iterator[tuple[str, Way]]:
    """The image files that a scene names, and the way to each in the model."""
    scene = document.scene
    if scene.background.image is not None:
        yield scene.background.image, ("background", "image")
    for number, light in enumerate(scene.lights):
        if light.image is not None:
            yield light.image, ("lights", number, "image")
    for number, node in enumerate(scene.csg):
        for slot, texture in enumerate(node.textures if isinstance(node, Leaf) else ()):
            if texture is not None and texture.image is not None:
                yield texture.image, ("csg", number, "textures", slot)


def meshes(document: Document) -> dict[str, Way]:
    """The mesh files that a scene names, and the way to each in the model."""
    csg = enumerate(document.scene.csg)
    return {node.file: ("csg", n, "file") for n, node in csg if isinstance(node, Leaf) and node.file is not None}
