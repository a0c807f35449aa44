"""What a scene needs as a whole, and what in it has no effect."""

import functools
from collections.abc import Collection, Iterator, Sequence

from ..model import GREY, Leaf, Operator, Surface, Vector
from .document import Document
from .hints import nearest
from .messages import listing, quote
from .names import ALIASES, BUILT_IN
from .words import WORDS, canonical

#: What messages call a material.
CALLED = {
    "conductor": canonical("CONDUCTOR"),
    "dielectric": canonical("DIELECTRIC"),
    "lambertian": canonical("MATERIAL_KIND", "lambertian"),
    "composite": canonical("MATERIAL_KIND", "composite"),
    "phong": "surface without a material",
}
#: Below this, the intensity of a light, of AMBIENT or of BACKGROUND is most likely a mistake.
DARK = 256


def whole(document: Document) -> None:
    """Raises the first SceneError about a scene, and emits its SceneWarnings."""
    scene = document.scene
    for i, light in enumerate(scene.lights):
        _effects(document, light.distribution, f"{light.distribution.upper()} light", "LIGHT_PARAMETER", "lights", i)
    for index, surface in scene.surfaces.items():
        _surface(document, index, surface)
    _leaves(document)
    _unused(document)
    _dark(document)


@functools.cache
def _of_others(role: str, kind: str) -> dict[str, tuple[str, ...]]:
    """The parameters of a role that a kind does not know: their names, and the kinds that do."""
    particular = {
        word.name: tuple(word.of)
        for word in WORDS
        if word.of and (word.role == role or (word.role == "METAL" and role == "OPTIC"))
    }
    return {name: kinds for name, kinds in particular.items() if kind not in kinds}


def _effects(document: Document, kind: str, called: str, role: str, *owner: str | int) -> None:
    """Warns of the given parameters that a kind of light or material does not know."""
    given = [
        ((*owner, name), kinds) for name, kinds in _of_others(role, kind).items() if (*owner, name) in document.places
    ]
    for path, kinds in sorted(given, key=lambda one: document.places[one[0]].start):
        meant = listing(kind.upper() if role == "LIGHT_PARAMETER" else CALLED[kind] for kind in kinds)
        document.warn(f"{_word(document, *path)} has no effect on a {called}; it is for a {meant}", *path)


def _word(document: Document, *path: str | int) -> str:
    """A keyword as the text has it."""
    place = document.place(*path)
    return document.source.text[place.start : place.end]


def _surface(document: Document, index: int, surface: Surface) -> None:
    """What a material needs, and what has no meaning for it."""
    path = "surfaces", index
    kind = surface.material
    if kind == "conductor":
        if surface.metal and (surface.eta or surface.k):
            raise document.error(
                "a metal's name and n-refr or k-abs are given; expected one of the two", *path, "metal"
            )
        if not surface.metal and not (surface.eta and surface.k):
            raise document.error("a condutor lacks its optics; expected n-refr and k-abs, or a metal's name", *path)
    elif kind == "dielectric":
        _glass(document, index, surface)
    elif kind == "composite" and not surface.eta:
        raise document.error("a composto lacks its index; expected n-refr", *path)
    elif kind == "composite" and surface.ks and max(map(sum, zip(surface.kd or GREY, surface.ks))) > 1 + 1e-6:
        raise document.error("kd + ks is above 1 in a composto; expected s + d = 1 at most", *path)
    _effects(document, kind or "phong", CALLED[kind or "phong"], "OPTIC", *path)


def _glass(document: Document, index: int, surface: Surface) -> None:
    path = "surfaces", index
    if surface.glass and (surface.eta or surface.abbe):
        raise document.error("a glass's name and n-refr or abbe are given; expected one of the two", *path, "glass")
    if not surface.glass and not surface.eta:
        raise document.error("a dieletrico lacks its index; expected n-refr, or a glass's name after dieletrico", *path)
    if document.given(*path, "thickness") and not surface.transmittance:
        document.warn(
            f"{_word(document, *path, 'thickness')} has no effect without transmitancia, which is what that thickness "
            "lets through",
            *path,
            "thickness",
        )


def lacking(
    csg: Sequence[Operator | Leaf], surfaces: Collection[int], transforms: Collection[int]
) -> Iterator[tuple[int, str]]:
    """The leaves without SURFACE or TRANSFORM, one for each index: their numbers in the tree, and what they lack."""
    said = set()
    for number, leaf in enumerate(csg):
        if not isinstance(leaf, Leaf) or leaf.index in said:
            continue
        tables = (surfaces, f"SURFACE {leaf.index}"), (transforms, f"TRANSFORM {leaf.index}")
        missing = [name for table, name in tables if leaf.index not in table]
        if missing:
            said.add(leaf.index)
            yield (
                number,
                f"{leaf.shape.upper()} {leaf.index} has no {' and no '.join(missing)}; expected "
                + (f"a statement {missing[0]}" if len(missing) == 1 else f"statements {' and '.join(missing)}"),
            )


def _leaves(document: Document) -> None:
    """Indices and texture names that lead nowhere."""
    scene = document.scene
    for number, reason in lacking(scene.csg, scene.surfaces, scene.transforms):
        given = sorted(scene.surfaces if "SURFACE" in reason else scene.transforms)
        known = f"; there are {listing(given[:20], 'and')}" if given else ""
        raise document.error(reason + known, "csg", number)
    for number, leaf in enumerate(scene.csg):
        if not isinstance(leaf, Leaf):
            continue
        for slot, texture in enumerate(leaf.textures):
            path = "csg", number, "textures", slot
            if texture and texture.name and texture.name not in scene.patterns:
                names = list(dict.fromkeys([*BUILT_IN, *scene.patterns]))
                raise document.error(
                    f"unknown texture {quote(texture.name)}; expected {listing(names[:20])}, an image file "
                    f"or NULL{nearest(texture.name, [*names, *ALIASES])}",
                    *path,
                )
            if slot == 1 and texture and texture.image:
                raise document.error(
                    "an image stands in the second texture slot, which is solid; expected it in the first", *path
                )


def _dark(document: Document) -> None:
    """Warns of intensities that were meant as 1.0, or as 255."""
    scene = document.scene
    given: list[tuple[Vector, str, tuple[str | int, ...]]] = [
        (light.intensity, "Intensity", ("lights", i, "intensity")) for i, light in enumerate(scene.lights)
    ]
    given.append((scene.ambient, "AMBIENT", ("ambient",)))
    if scene.background.image is None:
        given.append((scene.background.color, "BACKGROUND", ("background",)))
    for color, word, path in given:
        if 0 < max(color) < DARK:
            document.warn(f"this {word} is all but dark: 65535 is 1.0", *path)


def _unused(document: Document) -> None:
    """What is given and never used, and what is missing."""
    scene = document.scene
    used = {node.index for node in scene.csg if isinstance(node, Leaf)}
    for name, table in (("surfaces", scene.surfaces), ("transforms", scene.transforms)):
        for index in table:
            if index not in used:
                document.warn(
                    f"{_word(document, name, index)} {index} is not used: no primitive has this index", name, index
                )
    for path in document.places:
        if path[0] == "defaults" and path[1] not in document.uses:
            document.warn(f"nothing below uses ${path[1]}", *path)
    if not scene.csg:
        document.warn("the scene has no CSG-TREE: nothing but the background is seen", "csg")
    if not scene.lights:
        document.warn("the scene has no lights", "lights")
