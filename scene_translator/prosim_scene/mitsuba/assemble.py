"""Translates a scene to a dictionary of Mitsuba's plugins: the statements of the scene, and the meshes of its CSG
tree.
"""

from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Protocol

from ..geometry import TOLERANCE, Look, MeshKey, TranslationCache, Triangles, tessellate
from ..geometry.grouping import group_equal
from ..language.document import Document
from ..model import Leaf, Light, Scene
from ..nodes import Comment, Node
from ..view import camera_of, warn_of_distortion
from ..writer import ply_bytes
from . import lights, materials, prosim_target, stock_target
from .materials import MediumInterface
from .sensor import sensor
from .translation_context import Context, Options, check_single_precision, meshes


class Target(Protocol):
    """Translates parts of a scene to Mitsuba dictionaries; a module for the plugins of this project or of Mitsuba."""

    #: Plugin name of the sampler; its sample count is N^2, where N is NSAMPLES of the scene.
    SAMPLER: str
    #: Plugin name of the sensor of a camera with an aperture.
    LENS: str

    def settings(self, context: Context) -> Node:
        """Returns the scene's settings, such as the integrator, as entries of the scene's dictionary."""

    def light(self, context: Context, number: int, light: Light) -> Node:
        """Returns the emitter, or the shape with an emitter, of the AREA or POINT light with this number."""

    def surface(self, context: Context, number: int, leaf: Leaf, sides: MediumInterface) -> Node:
        """Returns the entries of a shape's dictionary for the SURFACE of the primitive ``leaf``, which is node
        ``number`` of the CSG tree, between the media of its sides.
        """


def medium_key(scene: Scene, leaf: Leaf) -> Hashable:
    """Returns a key of the medium inside a primitive, its refraction and absorption; None if it is opaque."""
    surface = scene.surfaces[leaf.index]
    if surface.material != "dielectric":
        return None
    return surface.eta, surface.glass, surface.abbe, surface.transmittance, surface.thickness


def appearance_key(scene: Scene, leaf: Leaf) -> Hashable:
    """Returns a key of material and textures, for primitives that may share a mesh. A solid texture depends on the
    transform, so the key then has the primitive's index.
    """
    surface = scene.surfaces[leaf.index]
    textures = materials.effective_textures(leaf, surface)
    return surface, textures, leaf.index if textures[1] else None


def looks(scene: Scene) -> list[Look]:
    """Returns the look of each primitive of a scene's CSG tree."""
    leaves = [leaf for _, leaf in scene.leaves]
    fresnel = [scene.surfaces[leaf.index].material in ("conductor", "composite") for leaf in leaves]
    return [Look(appearance_key(scene, leaf), medium_key(scene, leaf), own) for leaf, own in zip(leaves, fresnel)]


def assemble(
    document: Document,
    options: Options,
    store: Callable[[str, bytes], str],
    image_path: Callable[[Path], str] = str,
    cache: TranslationCache | None = None,
) -> Node:
    """Returns the Mitsuba dictionary of a scene, for the target that ``options`` selects.

    ``store(name, content)`` stores the PLY file of a mesh, ``image_path(path)`` converts the path of an image file;
    both functions return the file name that the dictionary contains. ``cache`` may contain the evaluated CSG tree of an
    earlier translation, and stores that of this translation. Raises SceneError if the scene cannot be translated.
    """
    scene = document.scene
    target: Target = prosim_target if options.target == "prosim" else stock_target
    context = Context(document, options, image_path)
    camera = camera_of(document, options.resolution)
    triangles = tessellate(
        document,
        camera,
        options.tolerance or TOLERANCE,
        looks(scene),
        {name: context.read_mesh(name, *place) for name, place in meshes(document).items()},
        cache or TranslationCache(),
    )

    result: Node = {"type": "scene"} | check_single_precision(document, target.settings(context))
    result["view_comment"] = _comment_with_line(document, "VIEW", "view")
    if options.target == "stock":
        camera = stock_target.camera(context, camera)
    elif options.resolution is None:
        warn_of_distortion(document)
    view_sensor = sensor(context, camera, target.LENS, target.SAMPLER, triangles.values())
    result["view"] = check_single_precision(document, view_sensor, "view")
    lights.warn_of_hidden_lights(context, [mesh.positions for mesh in triangles.values()])
    for i, light in enumerate(scene.lights):
        lights.warn_of_radius(context, i, light)
        result[f"light_{i}_comment_with_line"] = _comment_with_line(document, light.kind.upper(), "lights", i)
        emitter = lights.sky_emitter if light.kind == "sky" else target.light
        result[f"light_{i}"] = check_single_precision(document, emitter(context, i, light), "lights", i)
    return result | _shapes(context, target, triangles, store)


def _shapes(
    context: Context, target: Target, triangles: dict[MeshKey, Triangles], store: Callable[[str, bytes], str]
) -> Node:
    """Returns the shapes, each after a comment, in the order in which materials first occur in the CSG tree."""
    document, scene = context.document, context.scene
    groups = group_equal(appearance_key(scene, leaf) for _, leaf in scene.leaves)
    first_leaves = [scene.leaves[positions[0]][1] for positions in groups.values()]
    # Medium -> the index of the first SURFACE in the CSG tree that has this medium.
    surface_of_medium: dict[Hashable, int] = {medium_key(scene, leaf): leaf.index for leaf in reversed(first_leaves)}
    result: Node = {}
    for key, mesh in sorted(triangles.items(), key=lambda item: groups[item[0].material][0]):
        number, leaf = scene.leaves[groups[key.material][0]]
        path = "surfaces", leaf.index
        with_uv = materials.effective_textures(leaf, scene.surfaces[leaf.index])[0] is not None
        names = list(dict.fromkeys(document.name_of(scene.leaves[i][0], whole=True) for i in groups[key.material]))
        leaf_names = ", ".join(names[:3]) + ", ..." * (len(names) > 3)
        name = f"surface_{leaf.index}"
        while name in result:
            name += "_"
        ply = ply_bytes(mesh, with_uv)
        if ply is None:
            reason = "it is too small for Mitsuba's single precision; enlarge it"
            document.warn(f"nothing is visible of {leaf_names}: {reason}", "transforms", leaf.index)
            continue
        sides = MediumInterface(
            leaf.index if key.inside == medium_key(scene, leaf) else surface_of_medium[key.inside],
            None if key.outside is None else surface_of_medium[key.outside],
        )
        towards = "" if sides.outside is None else f" towards {document.surface_name(sides.outside)}"
        text = f"{document.surface_name(leaf.index)} of {leaf_names}{towards}"
        result[name + "_comment"] = _comment_with_line(document, text, *path)
        optics = check_single_precision(document, target.surface(context, number, leaf, sides), *path)
        result[name] = {"type": "ply", "filename": store(name, ply), **optics}
    return result


def _comment_with_line(document: Document, text: str, *path: str | int) -> Comment:
    return Comment(f"{text} (line {document.line(*path)})")
