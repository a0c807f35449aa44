"""Defines the options and the context of a translation, finds the files that a scene uses, and checks
numbers against the limit of single precision.
"""

import math
import operator
import os
from collections.abc import Callable
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ..geometry.leaves import LARGEST
from ..geometry.mesh_files import MeshFile, mesh_file
from ..geometry.primitives import Primitive
from ..language.diagnostics import SceneError, quote
from ..language.document import Document
from ..language.document import Path as ValuePath
from ..language.words import PIXELS, Numbers, numbers_of
from ..nodes import Node, plain, values_in

T = TypeVar("T")
#: The plugins that the translation uses: those of this project, or only those of Mitsuba.
TARGETS = ("prosim", "stock")
#: The units of the Intensity of a light, which ``mitsuba.lights`` describes.
UNITS = ("calibrated", "radiance", "unattenuated")


@dataclass(frozen=True, kw_only=True)
class Options:
    """The options of :func:`prosim_scene.translate`. Raises SceneError for a wrong value."""

    target: str = "prosim"
    light_units: str = "calibrated"
    tolerance: float | None = None
    resolution: tuple[int, int] | None = None
    samples: int | None = None
    allow_outside: bool = False

    def __post_init__(self) -> None:
        self._check("target", self.target in TARGETS, f"one of {', '.join(TARGETS)}")
        self._check("light_units", self.light_units in UNITS, f"one of {', '.join(UNITS)}")
        self._check("tolerance", self.tolerance is None or _is_positive(self.tolerance), "a number of pixels above 0")
        # The numbers become Python's, because those of NumPy overflow and are not written to XML.
        if self.tolerance is not None:
            object.__setattr__(self, "tolerance", float(self.tolerance))
        if self.samples is not None:
            numbers, allowed = _whole_numbers([self.samples]), numbers_of("SETTING", "samples")
            self._check("samples", _are_allowed(numbers, allowed), allowed.range_in_words())
            object.__setattr__(self, "samples", numbers[0])
        if self.resolution is not None:
            numbers, allowed = _whole_numbers(self.resolution), numbers_of("VIEW_PARAMETER", "resolution")
            expected = f"width and height, each {allowed.range_in_words()}, and {PIXELS} in all"
            self._check("resolution", _are_allowed(numbers, allowed), expected)
            object.__setattr__(self, "resolution", numbers)

    def _check(self, name: str, allowed: bool, expected: str) -> None:
        if not allowed:
            raise SceneError(f"{name} is {getattr(self, name)!r}; expected {expected}")


def _is_positive(value: Any) -> bool:
    return isinstance(value, Real) and 0 < float(value) < math.inf


def _whole_numbers(values: Any) -> tuple[int, ...]:
    """Returns the whole numbers ``values``; () if these are something else."""
    try:
        return tuple(map(operator.index, values))
    except TypeError:
        return ()


def _are_allowed(numbers: tuple[int, ...], allowed: Numbers) -> bool:
    return len(numbers) == allowed.count and all(map(allowed.allows, numbers)) and math.prod(numbers) <= PIXELS


class Context:
    """The context of a translation: the ``document``, its ``scene``, and the ``options`` of the translation.

    ``samples`` is the number N of samples that the option ``samples`` states, or else NSAMPLES of the scene. The
    function ``image_path`` converts the path of an image file to the file name that the translated scene contains.
    ``reported`` is the set of the warnings of :meth:`warn_once`.
    """

    def __init__(self, document: Document, options: Options, image_path: Callable[[Path], str]) -> None:
        self.document, self.scene, self.options = document, document.scene, options
        self.samples = options.samples or document.scene.samples
        self.image_path = image_path
        self.reported = set[tuple[str, int]]()

    def warn_once(self, reason: str, *path: str | int, each_line: bool = False) -> None:
        """Warns of the value at ``path``, once for each ``reason``, or once for each line and ``reason``."""
        if (key := (reason, self.document.line(*path) if each_line else 0)) not in self.reported:
            self.reported.add(key)
            self.document.warn(reason, *path)

    def read_mesh(self, name: str, *path: str | int) -> Primitive:
        """Returns the solid of the mesh file ``name``. Raises SceneError if the option ``allow_outside`` forbids the
        file's folder, or if the file cannot be read or has no closed mesh. Warns of overlaps in the mesh.
        """
        mesh = self._read_file("mesh", _mesh, name, *path)
        if mesh.warning:
            self.document.warn(f"the mesh {quote(name)} {mesh.warning}", *path)
        return mesh

    def image(self, plugin: str, name: str, *path: str | int) -> Node:
        """Returns the dictionary of the Mitsuba plugin ``plugin``, a texture or an environment emitter, with the image
        file ``name``.

        Raises SceneError if the option ``allow_outside`` forbids the file's folder, or if there is no such file. Only
        Mitsuba knows whether it is an image.
        """
        return {"type": plugin, "filename": self._read_file("image", self.image_path, name, *path)}

    def _read_file(self, kind: str, read: Callable[[Path], T], name: str, *path: str | int) -> T:
        """Returns ``read(file)``, where ``file`` is the path of the file that the scene calls ``name``."""
        folder = Path(self.document.source.filename).parent
        try:
            if not name or "\0" in name:
                raise ValueError("is not a valid file name; expected the name of a file in the scene's folder")
            full = Path(os.path.realpath(located(folder, name)))  # realpath also accepts circular links
            if not self.options.allow_outside and not full.is_relative_to(folder.resolve()):
                raise ValueError("is outside the scene's folder; move it, or use --allow-outside (allow_outside=True)")
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


def _mesh(path: Path) -> MeshFile:
    if path.stat().st_size > MESH_LIMIT:
        raise ValueError(f"is larger than {MESH_LIMIT >> 20} MiB, the largest size of a mesh file")
    return mesh_file(path.read_bytes())


def check_single_precision(document: Document, node: Node, *path: str | int) -> Node:
    """Returns the dictionary ``node`` unchanged; raises SceneError if a number in it is NaN, or has a magnitude above
    :data:`.LARGEST`, so that its square may be too large for Mitsuba's single precision.

    ``path`` is the path in the model, such as ("lights", 0), of the value from which ``node`` was made.
    """
    for value in values_in(plain(node, np.asarray)):
        for number in () if isinstance(value, str) else np.ravel(value).tolist():
            if not abs(number) <= LARGEST:
                reason = f"this gives {number:g}, which is beyond Mitsuba's single precision; "
                raise document.error(f"{reason}expected less extreme numbers", *path)
    return node


def located(folder: Path, name: str) -> Path:
    """Returns the path of the file ``name``, relative to the scene's folder ``folder``."""
    return folder / name.replace("\\", "/")


def images(document: Document) -> list[tuple[str, ValuePath]]:
    """Lists the uses of image files: the name, and its path in the model, such as ("background", "image")."""
    scene = document.scene
    names: dict[ValuePath, str | None] = {("background", "image"): scene.background.image}
    names |= {("lights", number, "image"): light.image for number, light in enumerate(scene.lights)}
    for number, leaf in scene.leaves:
        names |= {("csg", number, "textures", i): texture.image for i, texture in enumerate(leaf.textures) if texture}
    return [(name, path) for path, name in names.items() if name is not None]


def meshes(document: Document) -> dict[str, ValuePath]:
    """Returns a dictionary from the name of each mesh file that a scene uses to the path of this name in the model,
    such as ("csg", 5, "file"). If several primitives use the mesh file, the path is that of the last one.
    """
    return {leaf.file: ("csg", number, "file") for number, leaf in document.scene.leaves if leaf.file is not None}
