"""Scene model -> Mitsuba scene: XML and meshes on disk, or a dictionary."""

import atexit
import os
import shutil
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np

from . import lights, materials, mesh, stock, view, xml
from .errors import SceneError
from .model import Leaf, Texture
from .reader import parse, read
from .solids import TOLERANCE, tessellate
from .solids.transforms import matrix
from .textures import rgb
from .xml import Comment, Default

TARGETS = ("prosim", "stock")


class _Translation:
    """One scene on its way: options, approximations said so far, and the meshes."""

    def __init__(self, scene, folder, *, target="prosim", light_units="calibrated", tolerance=None, resolution=None,
                 samples=None, allow_outside=False):
        for name, value, allowed in (("target", target, TARGETS), ("light_units", light_units, lights.UNITS)):
            if value not in allowed:
                raise ValueError(f"{name} is {value!r}; expected one of {', '.join(allowed)}")
        if tolerance is not None and not 0 < tolerance < float("inf"):
            raise ValueError(f"tolerance is {tolerance!r}; expected a number of pixels above 0")
        if samples is not None and samples < 1:
            raise ValueError(f"samples is {samples!r}; expected 1 or more")
        if resolution is not None and min(resolution) < 1:
            raise ValueError(f"resolution is {resolution!r}; expected a width and a height of 1 or more")
        self.scene, self.folder, self.target, self.light_units = scene, Path(folder), target, light_units
        self.tolerance = TOLERANCE if tolerance is None else tolerance
        self.samples = samples or scene.samples
        self.allow_outside = allow_outside
        self.camera = view.camera(scene, tuple(resolution) if resolution else None)
        self.said = set()

    def approximate(self, place, reason):
        """Says once what could not be said exactly."""
        if reason not in self.said:
            self.said.add(reason)
            warnings.warn(self.scene.source.warning(place, reason), stacklevel=2)

    def image(self, texture):
        """The absolute path of an image file of the scene; it has to lie in the scene's folder or below."""
        error = self.scene.source.error
        path = Path(texture.image.replace("\\", "/"))
        full = (self.folder / path).resolve()
        if not self.allow_outside and not full.is_relative_to(self.folder.resolve()):
            raise error(texture.at, f"the image {texture.image!r} lies outside the scene's folder; expected a path in it")
        if not full.is_file():
            raise error(texture.at, f"the image {texture.image!r} does not exist in the scene's folder")
        return full

    def material_key(self, leaf):
        """Equal for leaves that look alike."""
        surface = self.scene.surfaces[leaf.index]
        slots = leaf.textures if surface.material not in ("conductor", "dielectric") else (None, None)
        return (tuple(getattr(surface, name) for name in ("material", "metal", "ka", "kd", "ks", "eta", "k", "exponent",
                                                          "slope")),
                slots, leaf.index if slots[1] else None)

    def medium(self, leaf):
        """The medium inside a dielectric; None, the opaque one, inside anything else."""
        surface = self.scene.surfaces[leaf.index]
        return surface.eta if surface.material == "dielectric" else None

    def build(self, mesh_path, image_path):
        """The scene's dictionary and its meshes {name: Triangles}.

        ``mesh_path(name)`` and ``image_path(path)`` make the file names that stand in the dictionary.
        """
        scene = self.scene
        alike = {}  # the leaves of each material
        for leaf in scene.csg:
            if isinstance(leaf, Leaf):
                alike.setdefault(self.material_key(leaf), []).append(leaf)
        surfaces = tessellate(scene, self.camera, self.tolerance, self.medium, self.material_key)

        maker = stock if self.target == "stock" else prosim
        result = {"type": "scene"} | maker.settings(self, image_path)
        result["view_comment"] = self.comment("VIEW", scene.view)
        result["view"] = self.sensor()
        for i, light in enumerate(scene.lights):
            result[f"light_{i}_comment"] = self.comment(light.kind.upper(), light)
            result[f"light_{i}"] = maker.light(self, light)
        meshes = {}
        for key, leaves in alike.items():
            if key not in surfaces:
                continue
            leaf = leaves[0]
            surface, slots = scene.surfaces[leaf.index], key[1]
            name = f"surface_{leaf.index}"
            while name in meshes:
                name += "_"
            meshes[name] = surfaces[key], slots[0] is not None
            bearers = ", ".join(f"{x.shape.upper()} {x.index}" for x in leaves[:3]) + (", ..." if len(leaves) > 3 else "")
            result[name + "_comment"] = self.comment(f"SURFACE {leaf.index} of {bearers}", surface)
            result[name] = {"type": "ply", "filename": mesh_path(name),
                            **maker.surface(self, leaf, surface, slots, lambda t: image_path(self.image(t)))}
        return result, meshes

    def comment(self, text, statement):
        return Comment(f"{text} (line {self.scene.source.line(statement.at)})")

    def sensor(self):
        camera = stock.square(self, self.camera) if self.target == "stock" else self.camera
        width, height = camera.resolution
        film = {"type": "hdrfilm", "width": Default("width", width), "height": Default("height", height),
                "pixel_format": "rgb", "component_format": "float32", "filter": {"type": "box"}}
        sampler = {"type": "multijitter" if self.target == "stock" else "nrook", "sample_count": self.samples**2}
        return view.sensor(camera, film, sampler)


class prosim:
    """How this project's plugins say it."""

    @staticmethod
    def settings(translation, image_path):
        scene = translation.scene
        names = "SAVE-RGB, MAX-LEVEL, NSAMPLES, DO-SHADOW, AMBIENT, BACKGROUND"
        background = rgb(lights.radiometric(scene.background.color))
        if scene.background.image:
            texture = Texture(image=scene.background.image, at=scene.background.at)
            background = {"type": "bitmap", "filename": image_path(translation.image(texture))}
        return {
            "comment": Comment(f"{scene.name}: {names}"),
            "integrator": {
                "type": "prosim", "samples": Default("samples", translation.samples), "max_level": scene.max_level,
                "shadows": scene.shadows, "ambient": rgb(lights.radiometric(scene.ambient)), "background": background,
                "hide_emitters": True,
                "channels": "".join(c for c, saved in zip("rgb", scene.channels) if saved),
            },
        }

    @staticmethod
    def light(translation, light):
        return lights.emitter(translation.scene, light, translation.light_units)

    @staticmethod
    def surface(translation, leaf, surface, slots, images):
        inverse = np.linalg.inv(matrix(translation.scene.transforms[leaf.index])) if slots[1] else None
        return {"bsdf": materials.bsdf(translation.scene, surface, slots, inverse, images, translation.approximate)}


# ---- Entry points ----------------------------------------------------------------------------------------------------


def translate(source_path, out_dir=None, *, target="prosim", light_units="calibrated", tolerance=None, resolution=None,
              samples=None, allow_outside=False):
    """Translates a scene file to ``<out_dir>/<stem>.xml`` and ``<out_dir>/<stem>-meshes/*.ply``; returns the XML's path.

    ``out_dir``
        Folder of the result, made if need be; by default the scene's own.
    ``target``
        "prosim" for this project's plugins, "stock" for those alone that Mitsuba brings (what these cannot say is
        approximated, and each approximation is a SceneWarning, given once).
    ``light_units``
        "calibrated", "radiance" or "unattenuated": see :mod:`prosim_scene.lights`.
    ``tolerance``
        Largest chord error of a curved face, in pixels of the image (default 0.1).
    ``resolution``, ``samples``
        (width, height) and N instead of the scene's.
    ``allow_outside``
        Whether image files outside the scene's folder may be used.

    Everything is written, or nothing: wrong input raises :class:`SceneError` and leaves no file. Doubtful input is a
    :class:`SceneWarning`, through :mod:`warnings`.
    """
    source_path = Path(source_path)
    scene = parse(read(source_path), source_path)
    out_dir = Path(out_dir) if out_dir is not None else source_path.parent
    stem = source_path.stem
    folder = stem + "-meshes"
    translation = _Translation(scene, source_path.parent, target=target, light_units=light_units, tolerance=tolerance,
                               resolution=resolution, samples=samples, allow_outside=allow_outside)
    images = {}  # path in the scene's folder -> what the XML says

    def image_path(path):
        return images.setdefault(path, Path(os.path.relpath(path, out_dir.resolve())).as_posix())

    tree, meshes = translation.build(lambda name: f"{folder}/{name}.ply", image_path)
    files = {f"{name}.ply": mesh.ply(*content) for name, content in meshes.items()}
    text = xml.write(tree)
    try:
        out_dir.mkdir(parents=True, exist_ok=True)
        _write(out_dir, stem, folder, text, files)
    except OSError as error:
        raise SceneError(f"{error.filename or out_dir}: {error.strerror or error}", str(source_path)) from None
    return out_dir / f"{stem}.xml"


def _write(out_dir, stem, folder, text, files):
    """All files into a temporary folder beside the target; then they take the old ones' places."""
    with tempfile.TemporaryDirectory(prefix=f".{stem}-", dir=out_dir) as temporary:
        temporary = Path(temporary)
        (temporary / "new").mkdir()
        for name, content in files.items():
            (temporary / "new" / name).write_bytes(content)
        (temporary / "scene.xml").write_text(text, encoding="utf-8")
        if (out_dir / folder).exists():
            os.replace(out_dir / folder, temporary / "old")
        os.replace(temporary / "new", out_dir / folder)
        os.replace(temporary / "scene.xml", out_dir / f"{stem}.xml")


def load(path, *, transform=None, **options):
    """A scene file as a dictionary for ``mi.load_dict``; the options are those of :func:`translate`.

    The meshes are written to a temporary folder that lives as long as the process. Mitsuba takes its own type alone for
    transforms: ``transform`` turns a 4x4 array into it. By default it is ``mitsuba.ScalarTransform4f`` of the active
    variant where Mitsuba has been imported, and otherwise arrays are left as they are.
    """
    path = Path(path)
    translation = _Translation(parse(read(path), path), path.parent, **options)
    folder = Path(tempfile.mkdtemp(prefix="prosim-scene-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    tree, meshes = translation.build(lambda name: str(folder / f"{name}.ply"), str)
    for name, content in meshes.items():
        (folder / f"{name}.ply").write_bytes(mesh.ply(*content))
    mitsuba = sys.modules.get("mitsuba")
    if transform is None and mitsuba is not None and mitsuba.variant() is not None:
        transform = mitsuba.ScalarTransform4f
    return xml.plain(tree, transform or (lambda matrix: matrix))


def check(path, **options):
    """Reads and judges a scene file without writing anything: raises :class:`SceneError` as :func:`translate` would.

    Returns the scene. The whole tree is evaluated, so that what vanishes or is empty is reported too.
    """
    path = Path(path)
    scene = parse(read(path), path)
    _Translation(scene, path.parent, **options).build(str, str)
    return scene
