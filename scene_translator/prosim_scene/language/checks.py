"""What materials and lights need, and a scene as a whole, and what has no effect."""

import functools
import itertools
from collections.abc import Collection, Iterator, Sequence

from ..model import GREY, Leaf, Light, Operator, Surface, Vector
from .document import Document, Places
from .hints import nearest
from .messages import MOST, Said, listing, quote
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


def light(places: Places, number: int, light: Light) -> None:
    """Keeps the doubts about a light."""
    kind = light.distribution
    _effects(places, kind, f"{kind.upper()} light", "LIGHT_PARAMETER", "lights", number)


def surface(places: Places, index: int, surface: Surface) -> None:
    """Raises SceneError for what a material lacks, and keeps the doubts about what has no meaning for it."""
    path = "surfaces", index
    if found := wrong(surface):
        reason, *at = found
        raise places.error(reason, *path, *at)
    if surface.material == "dielectric" and places.given(*path, "thickness") and not surface.transmittance:
        _doubt(
            places,
            "{} has no effect without transmitancia, which is what that thickness lets through",
            *path,
            "thickness",
        )
    kind = surface.material or "phong"
    _effects(places, kind, CALLED[kind], "OPTIC", *path)


def wrong(surface: Surface) -> tuple[str, ...]:
    """What is wrong with a material, and of which of its values that is said; nothing where it is right."""
    kind = surface.material
    if kind == "conductor":
        if surface.metal and (surface.eta or surface.k):
            return "a metal's name and n-refr or k-abs are given; expected one of the two", "metal"
        if not surface.metal and not (surface.eta and surface.k):
            return ("a condutor lacks its optics; expected n-refr and k-abs, or a metal's name",)
    elif kind == "dielectric":
        if surface.glass and (surface.eta or surface.abbe):
            return "a glass's name and n-refr or abbe are given; expected one of the two", "glass"
        if not surface.glass and not surface.eta:
            return ("a dieletrico lacks its index; expected n-refr, or a glass's name after dieletrico",)
    elif kind == "composite" and not surface.eta:
        return ("a composto lacks its index; expected n-refr",)
    elif kind == "composite" and surface.ks and max(map(sum, zip(surface.kd or GREY, surface.ks))) > 1 + 1e-6:
        return ("kd + ks is above 1 in a composto; expected s + d = 1 at most",)
    return ()


@functools.cache
def _of_others(role: str, kind: str) -> dict[str, tuple[str, ...]]:
    """The parameters of a role that a kind does not know: their names, and the kinds that do."""
    particular = {
        word.name: tuple(word.of)
        for word in WORDS
        if word.of and (word.role == role or (word.role == "METAL" and role == "OPTIC"))
    }
    return {name: kinds for name, kinds in particular.items() if kind not in kinds}


def _effects(places: Places, kind: str, called: str, role: str, *owner: str | int) -> None:
    """Doubts the given parameters that a kind of light or material does not know."""
    for name, kinds in _of_others(role, kind).items():
        if places.given(*owner, name):
            meant = listing(kind.upper() if role == "LIGHT_PARAMETER" else CALLED[kind] for kind in kinds)
            _doubt(places, f"{{}} has no effect on a {called}; it is for a {meant}", *owner, name)


def _doubt(places: Places, reason: str, *path: str | int) -> None:
    """Keeps a doubt about a value; braces in ``reason`` stand for what the text has at its place."""
    places.source.doubt(places.place(*path), reason.format(places.word(*path)))


def whole(document: Document) -> Iterator[Said]:
    """What is wrong, and what is doubtful, in a scene as a whole."""
    return itertools.chain(_leaves(document), _unused(document), _dark(document))


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


def _leaves(document: Document) -> Iterator[Said]:
    """Indices that lead nowhere, and textures."""
    return itertools.chain(
        itertools.islice(_indices(document), MOST + 1), itertools.islice(_textures(document), MOST + 1)
    )


def _indices(document: Document) -> Iterator[Said]:
    scene = document.scene
    for i, (number, reason) in enumerate(lacking(scene.csg, scene.surfaces, scene.transforms)):
        given = sorted(scene.surfaces if "SURFACE" in reason else scene.transforms) if i == 0 else []
        known = f"; there are {listing(given[:20], 'and')}" if given else ""
        yield document.said(reason + known, "csg", number, error=True)


def _textures(document: Document) -> Iterator[Said]:
    scene = document.scene
    said: set[str] = set()
    for number, leaf in enumerate(scene.csg):
        if not isinstance(leaf, Leaf) or leaf.textures == (None, None):
            continue
        for slot, texture in enumerate(leaf.textures):
            path = "csg", number, "textures", slot
            if texture and texture.name and texture.name not in (*scene.patterns, *said):
                said.add(texture.name)
                names = list(dict.fromkeys([*BUILT_IN, *scene.patterns]))
                yield document.said(
                    f"unknown texture {quote(texture.name)}; expected {listing(names[:20])}, an image file "
                    f"or NULL{nearest(texture.name, [*names, *ALIASES])}",
                    *path,
                    error=True,
                )
            if slot == 1 and texture and texture.image:
                reason = "an image stands in the second texture slot, which is solid; expected it in the first"
                yield document.said(reason, *path, error=True)


def _dark(document: Document) -> Iterator[Said]:
    """Intensities that were meant as 1.0, or as 255."""
    scene = document.scene
    given: list[tuple[Vector, str, tuple[str | int, ...]]] = [
        (light.intensity, "Intensity", ("lights", i, "intensity")) for i, light in enumerate(scene.lights)
    ]
    given.append((scene.ambient, "AMBIENT", ("ambient",)))
    if scene.background.image is None:
        given.append((scene.background.color, "BACKGROUND", ("background",)))
    for color, word, path in given:
        if 0 < max(color) < DARK:
            yield document.said(f"this {word} is all but dark: 65535 is 1.0", *path)


def _unused(document: Document) -> Iterator[Said]:
    """What is given and never used, and what is missing."""
    scene = document.scene
    used = {node.index for node in scene.csg if isinstance(node, Leaf)}
    for name, table in (("surfaces", scene.surfaces), ("transforms", scene.transforms)):
        for index in table:
            if index not in used:
                word = document.word(name, index)
                yield document.said(f"{word} {index} is not used: no primitive has this index", name, index)
    if not scene.csg:
        yield document.said("the scene has no CSG-TREE: nothing but the background is seen", "csg")
    if not scene.lights:
        yield document.said("the scene has no lights", "lights")
