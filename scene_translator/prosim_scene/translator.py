"""Scene -> Mitsuba scene: XML and meshes on disk, or a dictionary."""

import atexit
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from . import geometry
from .language import document_of
from .language.document import Document
from .language.files import read
from .language.messages import SceneError
from .model import Leaf, Scene, Vector
from .nodes import Comment, Default, Node
from .targets import TARGETS, lights, materials, view
from .targets.context import Context
from .write import output, xml
from .write.ply import ply

AnyPath = str | os.PathLike[str]


@dataclass(frozen=True, kw_only=True)
class Options:
    """The options of a translation, those of :func:`translate`; ValueError for a value that is not allowed."""

    target: str = "prosim"
    light_units: str = "calibrated"
    tolerance: float | None = None
    resolution: tuple[int, int] | None = None
    samples: int | None = None
    allow_outside: bool = False

    def __post_init__(self) -> None:
        for name, value, allowed in (("target", self.target, tuple(TARGETS)), ("light_units", self.light_units, lights.UNITS)):
            if value not in allowed:
                raise ValueError(f"{name} is {value!r}; expected one of {', '.join(allowed)}")
        if self.tolerance is not None and not 0 < self.tolerance < float("inf"):
            raise ValueError(f"tolerance is {self.tolerance!r}; expected a number of pixels above 0")
        if self.samples is not None and self.samples < 1:
            raise ValueError(f"samples is {self.samples!r}; expected 1 or more")
        if self.resolution is not None and min(self.resolution) < 1:
            raise ValueError(f"resolution is {self.resolution!r}; expected a width and a height of 1 or more")


def medium(scene: Scene, leaf: Leaf) -> Vector | None:
    """The medium inside a dielectric; None, the opaque one, inside anything else."""
    surface = scene.surfaces[leaf.index]
    return surface.eta if surface.material == "dielectric" else None


def look(scene: Scene, leaf: Leaf) -> Hashable:
    """Equal for leaves that look alike, and share a mesh: a solid texture is bound to its leaf's own space."""
    surface = scene.surfaces[leaf.index]
    slots = materials.slots(leaf, surface)
    return surface, slots, leaf.index if slots[1] else None


def assemble(document: Document, folder: Path, options: Options, store: Callable[[str, bytes], str],
             image_path: Callable[[Path], str]) -> Node:
    """A scene's dictionary.

    ``folder`` is the scene's own, where its images are; ``store(name, content)`` takes the PLY file of a mesh and
    ``image_path(path)`` an image's path, and both return the file name that stands in the dictionary.
    """
    scene, target = document.scene, TARGETS[options.target]
    context = Context(document, folder, options.light_units, options.samples or scene.samples, options.allow_outside,
                      image_path)
    camera = view.camera(document, options.resolution)
    triangles = geometry.triangles(document, camera, options.tolerance or geometry.TOLERANCE,
                                   lambda leaf: medium(scene, leaf), lambda leaf: look(scene, leaf))

    def comment(text: str, *path: str | int) -> Comment:
        return Comment(f"{text} (line {document.line(*path)})")

    result: Node = {"type": "scene"} | target.settings(context)
    result["view_comment"] = comment("VIEW", "view")
    result["view"] = _sensor(context, options, camera)
    for i, light in enumerate(scene.lights):
        result[f"light_{i}_comment"] = comment(light.kind.upper(), "lights", i)
        result[f"light_{i}"] = target.light(context, i, light)
    alike: dict[Hashable, list[tuple[int, Leaf]]] = {}  # the leaves of each look, with their numbers in the tree
    for number, leaf in enumerate(scene.csg):
        if isinstance(leaf, Leaf):
            alike.setdefault(look(scene, leaf), []).append((number, leaf))
    for key, leaves in alike.items():
        if key not in triangles:
            continue
        number, leaf = leaves[0]
        name = f"surface_{leaf.index}"
        while name in result:
            name += "_"
        slots = materials.slots(leaf, scene.surfaces[leaf.index])
        bearers = ", ".join(f"{x.shape.upper()} {x.index}" for _, x in leaves[:3]) + (", ..." if len(leaves) > 3 else "")
        result[name + "_comment"] = comment(f"SURFACE {leaf.index} of {bearers}", "surfaces", leaf.index)
        result[name] = {"type": "ply", "filename": store(name, ply(triangles[key], with_uv=slots[0] is not None)),
                        **target.surface(context, number, leaf)}
    return result


def _sensor(context: Context, options: Options, camera: view.Camera) -> Node:
    target = TARGETS[options.target]
    camera = target.camera(context, camera)
    width, height = camera.resolution
    film = {"type": "hdrfilm", "width": Default("width", width), "height": Default("height", height),
            "pixel_format": "rgb", "component_format": "float32", "filter": {"type": "box"}}
    return view.sensor(camera, film, {"type": target.SAMPLER, "sample_count": context.samples**2})


# ---- Entry points ----------------------------------------------------------------------------------------------------


def translate(source_path: AnyPath, out_dir: AnyPath | None = None, *, target: str = "prosim",
              light_units: str = "calibrated", tolerance: float | None = None, resolution: tuple[int, int] | None = None,
              samples: int | None = None, allow_outside: bool = False) -> Path:
    """Translates a scene file to ``<out_dir>/<stem>.xml`` and the meshes that it names in ``<out_dir>/<stem>-meshes``; returns
    the XML's path.

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

    Everything is written, or nothing: wrong input raises :class:`SceneError` and leaves no file. Only what an earlier
    translation wrote is overwritten or removed. Doubtful input is a :class:`SceneWarning`, through :mod:`warnings`.
    """
    source_path = Path(source_path)
    options = Options(target=target, light_units=light_units, tolerance=tolerance, resolution=resolution, samples=samples,
                      allow_outside=allow_outside)
    document = document_of(read(source_path), source_path)
    folder = Path(out_dir) if out_dir is not None else source_path.parent
    stem = source_path.stem
    if (folder / f"{stem}.xml").exists() and os.path.samefile(folder / f"{stem}.xml", source_path):
        raise SceneError(f"{source_path}: the translation would overwrite the scene itself; give the scene another suffix, "
                         "such as .scn, or choose another folder", str(source_path))
    images: dict[Path, str] = {}  # path in the scene's folder -> what the XML says
    meshes: dict[str, bytes] = {}

    def image_path(path: Path) -> str:
        return images.setdefault(path, Path(os.path.relpath(path, folder.resolve())).as_posix())

    def store(name: str, content: bytes) -> str:
        meshes[file := output.mesh_name(name, content)] = content
        return f"{output.meshes_folder(stem)}/{file}"

    tree = {"mark": Comment(output.MARK), **assemble(document, source_path.parent, options, store, image_path)}
    try:
        return output.write(folder, stem, xml.write(tree), meshes)
    except OSError as error:
        raise SceneError(f"{error.filename or folder}: {error.strerror or error}", str(source_path)) from None


def load(path: AnyPath, *, transform: Callable[[Any], Any] | None = None, **options: Any) -> Node:
    """A scene file as a dictionary for ``mi.load_dict``; the options are those of :func:`translate`.

    The meshes are written to a temporary folder that lives as long as the process. Mitsuba takes its own type alone for
    transforms: ``transform`` turns a 4x4 array into it. By default it is ``mitsuba.ScalarTransform4f`` of the active
    variant where Mitsuba has been imported, and otherwise arrays are left as they are.
    """
    path = Path(path)
    checked = Options(**options)
    document = document_of(read(path), path)
    folder = Path(tempfile.mkdtemp(prefix="prosim-scene-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)

    def store(name: str, content: bytes) -> str:
        file = folder / f"{name}.ply"
        file.write_bytes(content)
        return str(file)

    try:
        tree = assemble(document, path.parent, checked, store, str)
    except OSError as error:
        raise SceneError(f"{error.filename or folder}: {error.strerror or error}", str(path)) from None
    mitsuba = sys.modules.get("mitsuba")
    if transform is None and mitsuba is not None and mitsuba.variant() is not None:
        transform = mitsuba.ScalarTransform4f
    return xml.plain(tree, transform or (lambda matrix: matrix))


def check(path: AnyPath, **options: Any) -> Scene:
    """Reads and judges a scene file without writing anything: raises :class:`SceneError` as :func:`translate` would.

    Returns the scene. The whole tree is evaluated, so that what vanishes or is empty is reported too.
    """
    path = Path(path)
    checked = Options(**options)
    document = document_of(read(path), path)
    assemble(document, path.parent, checked, lambda name, _: name, str)
    return document.scene
