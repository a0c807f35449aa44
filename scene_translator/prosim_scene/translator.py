"""Scene -> Mitsuba scene: XML and meshes on disk, or a dictionary."""

import atexit
import math
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from . import view
from .kept import Kept
from .language import document_of
from .language.document import Document
from .language.files import read
from .language.messages import SceneError
from .language.quantities import Numbers
from .language.words import PIXELS, numbers
from .model import Leaf, Scene
from .nodes import Comment, Default, Node
from .solids import TOLERANCE, Skin, Triangles, tessellate
from .targets import TARGETS, Target, clip, lights, materials, sensor, single
from .targets.context import Context
from .targets.materials import Sides
from .write import output, xml

AnyPath = str | os.PathLike[str]


@dataclass(frozen=True, kw_only=True)
class Options:
    """The options of a translation, those of :func:`translate`; SceneError for a value that is not allowed."""

    target: str = "prosim"
    light_units: str = "calibrated"
    tolerance: float | None = None
    resolution: tuple[int, int] | None = None
    samples: int | None = None
    allow_outside: bool = False

    def __post_init__(self) -> None:
        """Checks the values."""
        samples, pixels = numbers("SETTING", "samples"), numbers("VIEW_PARAMETER", "resolution")
        self._check("target", self.target in TARGETS, f"one of {', '.join(TARGETS)}")
        self._check("light_units", self.light_units in lights.UNITS, f"one of {', '.join(lights.UNITS)}")
        self._check("tolerance", self.tolerance is None or 0 < self.tolerance < math.inf, "a number of pixels above 0")
        self._check("samples", self.samples is None or _whole(self.samples, samples), samples.bounds())
        size = self.resolution
        self._check(
            "resolution",
            size is None or (len(size) == 2 and all(_whole(x, pixels) for x in size) and math.prod(size) <= PIXELS),
            f"width and height, each {pixels.bounds()}, and {PIXELS} in all",
        )

    def _check(self, name: str, allowed: bool, expected: str) -> None:
        if not allowed:
            raise SceneError(f"{name} is {getattr(self, name)!r}; expected {expected}")


def _whole(value: int, takes: Numbers) -> bool:
    return int(value) == value and takes.low <= value <= takes.high


def medium(scene: Scene, leaf: Leaf) -> Hashable:
    """The medium inside a dielectric, by what it refracts and absorbs; None, the opaque one, inside anything else."""
    surface = scene.surfaces[leaf.index]
    if surface.material != "dielectric":
        return None
    return surface.eta, surface.glass, surface.abbe, surface.transmittance, surface.thickness


def fresnel(scene: Scene, leaf: Leaf) -> bool:
    """Whether an opaque leaf reflects by Fresnel's equations, other than in air where it lies in a dielectric."""
    return scene.surfaces[leaf.index].material in ("conductor", "composite")


def look(scene: Scene, leaf: Leaf) -> Hashable:
    """Equal for leaves that look alike, and share a mesh: a solid texture is bound to its leaf's own space."""
    surface = scene.surfaces[leaf.index]
    slots = materials.slots(leaf, surface)
    return surface, slots, leaf.index if slots[1] else None


def assemble(
    document: Document,
    folder: Path,
    options: Options,
    store: Callable[[str, bytes], str],
    image_path: Callable[[Path], str],
    kept: Kept | None = None,
) -> Node:
    """A scene's dictionary.

    ``folder`` is the scene's own, where its images are; ``store(name, content)`` takes the PLY file of a mesh and
    ``image_path(path)`` an image's path, and both return the file name that stands in the dictionary. ``kept``: what an
    earlier translation has left, and this one leaves.
    """
    scene, target = document.scene, TARGETS[options.target]
    results, kept = kept.results if kept else None, kept or Kept()
    context = Context(
        document, folder, options.light_units, options.samples or scene.samples, options.allow_outside, image_path
    )
    camera = view.camera(document, options.resolution)
    single.check_transforms(document)
    triangles = tessellate(
        document,
        camera,
        options.tolerance or TOLERANCE,
        lambda leaf: medium(scene, leaf),
        lambda leaf: look(scene, leaf),
        lambda leaf: fresnel(scene, leaf),
        kept.faces,
        results,
    )

    def comment(text: str, *path: str | int) -> Comment:
        return Comment(f"{text} (line {document.line(*path)})")

    result: Node = {"type": "scene"} | single.check(document, target.settings(context))
    bodies = list(triangles.values())
    result["view_comment"] = comment("VIEW", "view")
    result["view"] = single.check(document, _sensor(context, target, camera, bodies), "view")
    for i, light in enumerate(scene.lights):
        lights.warn_of_radius(context, i, light)
        result[f"light_{i}_comment"] = comment(light.kind.upper(), "lights", i)
        result[f"light_{i}"] = single.check(document, target.light(context, i, light), "lights", i)
    skins: dict[Hashable, list[Skin]] = {}
    for skin in triangles:
        skins.setdefault(skin.material, []).append(skin)
    alike = _alike(scene)
    media: dict[Hashable, int] = {
        medium(scene, leaf): leaf.index for leaves in reversed(alike) for _, leaf in leaves[:1]
    }
    for leaves in alike:
        number, leaf = leaves[0]
        for skin in skins.get(look(scene, leaf), []):
            name = f"surface_{leaf.index}"
            while name in result:
                name += "_"
            if not np.abs(triangles[skin].vertices).max() <= single.LARGEST:
                raise document.error(
                    "this transform leads beyond single precision, Mitsuba's", "transforms", leaf.index
                )
            content = kept.file(triangles[skin], materials.slots(leaf, scene.surfaces[leaf.index])[0] is not None)
            bearers = ", ".join(f"{x.shape.upper()} {x.index}" for _, x in leaves[:3]) + (
                ", ..." if len(leaves) > 3 else ""
            )
            if content is None:
                document.warn(
                    f"nothing is seen of {bearers}: single precision, Mitsuba's, cannot tell its corners apart",
                    "transforms",
                    leaf.index,
                )
                continue
            sides = Sides(
                leaf.index if skin.inside == medium(scene, leaf) else media[skin.inside],
                None if skin.outside is None else media[skin.outside],
            )
            met = "" if sides.outside is None else f" towards SURFACE {sides.outside}"
            result[name + "_comment"] = comment(f"SURFACE {leaf.index} of {bearers}{met}", "surfaces", leaf.index)
            result[name] = {
                "type": "ply",
                "filename": store(name, content),
                **single.check(document, target.surface(context, number, leaf, sides), "surfaces", leaf.index),
            }
    return result


def _alike(scene: Scene) -> list[list[tuple[int, Leaf]]]:
    """The leaves that look alike, with their numbers in the tree."""
    alike: dict[Hashable, list[tuple[int, Leaf]]] = {}
    for number, leaf in enumerate(scene.csg):
        if isinstance(leaf, Leaf):
            alike.setdefault(look(scene, leaf), []).append((number, leaf))
    return list(alike.values())


def _sensor(context: Context, target: Target, camera: view.Camera, bodies: list[Triangles]) -> Node:
    camera = target.camera(context, camera)
    width, height = camera.resolution
    film = {
        "type": "hdrfilm",
        "width": Default("width", width),
        "height": Default("height", height),
        "pixel_format": "rgb",
        "component_format": "float32",
        "filter": {"type": "box"},
    }
    return sensor.sensor(
        camera,
        clip.planes(camera, bodies, context.scene.lights),
        film,
        {"type": target.SAMPLER, "sample_count": context.samples**2},
    )


# ---- Entry points ----------------------------------------------------------------------------------------------------


def document(path: AnyPath, define: Mapping[str, object] | None = None) -> Document:
    """A scene file, read: the scene, and the places of its values. ``define`` is that of :func:`prosim_scene.parse`.

    :func:`translate`, :func:`load` and :func:`check` take it instead of the path, so that a scene whose ``name`` is
    asked for first is read but once. Raises :class:`SceneError`.
    """
    return document_of(read(path), path, define)


def _opened(source: AnyPath | Document, define: Mapping[str, object] | None) -> tuple[Document, Path]:
    if isinstance(source, Document) and define:
        raise SceneError(f"{source.source.filename}: this document has been read; give define to prosim_scene.document")
    opened = source if isinstance(source, Document) else document(source, define)
    return opened, Path(opened.source.filename)


def translate(
    source: AnyPath | Document,
    out_dir: AnyPath | None = None,
    *,
    target: str = "prosim",
    light_units: str = "calibrated",
    tolerance: float | None = None,
    resolution: tuple[int, int] | None = None,
    samples: int | None = None,
    allow_outside: bool = False,
    define: Mapping[str, object] | None = None,
    kept: Kept | None = None,
) -> Path:
    """Writes a scene file, or a :func:`document`, as ``<out_dir>/<stem>.xml`` with its meshes; returns that path.

    ``out_dir``
        Folder of the result, made if need be; by default the scene's own.
    ``target``
        "prosim" for this project's plugins, "stock" for those alone that Mitsuba brings (what these cannot say is
        approximated, and each approximation is a SceneWarning, given once).
    ``light_units``
        "calibrated", "radiance" or "unattenuated": see :mod:`prosim_scene.targets.lights`.
    ``tolerance``
        Largest chord error of a curved face, in pixels of the image (default 0.1).
    ``resolution``, ``samples``
        (width, height) and N instead of the scene's.
    ``allow_outside``
        Whether image files outside the scene's folder may be used.
    ``define``
        Values, numbers or words, of the ``$names`` in the scene.
    ``kept``
        What an earlier translation has left, and this one leaves: meshes of the same solids are not made anew.

    Everything is written, or nothing: wrong input raises :class:`SceneError` and leaves no file. Only what an earlier
    translation wrote is overwritten or removed. Doubtful input is a :class:`SceneWarning`, through :mod:`warnings`.
    """
    options = Options(
        target=target,
        light_units=light_units,
        tolerance=tolerance,
        resolution=resolution,
        samples=samples,
        allow_outside=allow_outside,
    )
    opened, source_path = _opened(source, define)
    if not xml.can_say(source_path.stem):
        raise SceneError(
            f"{str(source_path)!r}: the names of the translation's files come from this one, and XML cannot hold "
            "it; expected a name without control characters, in UTF-8",
            str(source_path),
        )
    folder = Path(out_dir) if out_dir is not None else source_path.parent
    stem = source_path.stem
    result = folder / f"{stem}.xml"
    if result.exists() and source_path.exists() and result.samefile(source_path):
        raise SceneError(
            f"{source_path}: the translation would overwrite the scene itself; give the scene another suffix, "
            "such as .scn, or choose another folder",
            str(source_path),
        )
    meshes: dict[str, bytes] = {}

    def image_path(path: Path) -> str:
        relative = Path(os.path.relpath(path, folder.resolve())).as_posix()
        if not xml.can_say(relative):
            raise ValueError(f"the path {relative!r} cannot stand in XML; expected printable characters, in UTF-8")
        return relative

    def store(name: str, content: bytes) -> str:
        meshes[file := output.mesh_name(name, content)] = content
        return f"{output.meshes_folder(stem)}/{file}"

    tree = {"mark": Comment(output.MARK), **assemble(opened, source_path.parent, options, store, image_path, kept)}
    try:
        return output.write(folder, stem, xml.write(tree), meshes)
    except OSError as error:
        raise SceneError(f"{error.filename or folder}: {error.strerror or error}", str(source_path)) from None


def load(
    source: AnyPath | Document,
    *,
    transform: Callable[[Any], Any] | None = None,
    define: Mapping[str, object] | None = None,
    kept: Kept | None = None,
    **options: Any,
) -> Node:
    """A scene file as a dictionary for ``mi.load_dict``; the options are those of :func:`translate`.

    The meshes are written to a temporary folder that lives as long as the process. Mitsuba takes its own type alone for
    transforms: ``transform`` turns a 4x4 array into it. By default it is ``mitsuba.ScalarTransform4f`` of the active
    variant where Mitsuba has been imported, and otherwise arrays are left as they are.
    """
    checked = Options(**options)
    opened, path = _opened(source, define)
    folder = Path(tempfile.mkdtemp(prefix="prosim-scene-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)

    def store(name: str, content: bytes) -> str:
        file = folder / f"{name}.ply"
        file.write_bytes(content)
        return str(file)

    try:
        tree = assemble(opened, path.parent, checked, store, str, kept)
    except OSError as error:
        raise SceneError(f"{error.filename or folder}: {error.strerror or error}", str(path)) from None
    mitsuba = sys.modules.get("mitsuba")
    if transform is None and mitsuba is not None and mitsuba.variant() is not None:
        transform = mitsuba.ScalarTransform4f
    return xml.plain(tree, transform or (lambda matrix: matrix))


def check(source: AnyPath | Document, *, define: Mapping[str, object] | None = None, **options: Any) -> Scene:
    """Reads and judges a scene file without writing anything: raises :class:`SceneError` as :func:`translate` would.

    Returns the scene. The whole tree is evaluated, so that what vanishes or is empty is reported too.
    """
    checked = Options(**options)
    opened, path = _opened(source, define)
    assemble(opened, path.parent, checked, lambda name, _: name, str)
    return opened.scene
