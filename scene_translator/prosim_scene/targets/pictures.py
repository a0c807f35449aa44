"""Image files, as far as Mitsuba tells them by their first bytes, whatever their names end in."""

from collections.abc import Iterator
from pathlib import Path

from ..language.document import Document
from ..language.document import Path as Way
from ..model import Leaf

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
