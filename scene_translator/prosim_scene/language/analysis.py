"""Analyses a text: all its errors and warnings, and the document if it has no error."""

import math
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import count, islice
from os import PathLike
from pathlib import PurePath

from ..collector import paused
from ..model import GREY, Leaf, Pattern, Scene, Transform, Vector
from .diagnostics import MAX_ERRORS, SceneError, SceneWarning, Span, combined_error, listing, quote
from .document import Document, Path
from .reader import Reader
from .suggestions import nearest
from .words import ALIASES, BUILT_IN, KINDS, PIXELS, WORDS, canonical, of_role

#: The largest size of a text in bytes; a scene of 10,000 primitives has about 2 MiB.
SIZE_LIMIT = 16 * 2**20
#: The intensity of a light, of AMBIENT or of BACKGROUND below which a warning is emitted.
DARK = 256
#: Characters that are not allowed in the name of a scene.
NO_NAME = frozenset('/\\:*?<>|"')
#: (field of the model, parameter) -> the kinds of lights, materials or textures that have it; absent: all kinds.
LIMITED = {(of_role(word.statement)[0].name, word.name): word.of for word in WORDS if word.of}
#: Field of the model -> the field of its values that is their kind.
KIND_OF = {"lights": "distribution", "surfaces": "material", "patterns": "kind"}


def document_of(
    text: str, filename: str | PathLike[str] = "<string>", define: Mapping[str, object] | None = None
) -> Document:
    """The scene that ``text`` describes, with the places of its values; raises and warns as :func:`parse` does."""
    reader, found, document = analyse(text, filename, define)
    for problem in found:
        if isinstance(problem, SceneWarning):
            warnings.warn(problem, stacklevel=2)
    if document is None:
        raise combined_error([problem for problem in found if isinstance(problem, SceneError)])
    reader.definitions.check_uses()
    return document


def parse(text: str, filename: str | PathLike[str] = "<string>", define: Mapping[str, object] | None = None) -> Scene:
    """The scene that ``text`` describes, as a :class:`~prosim_scene.model.Scene`.

    ``define``: values, numbers or words, of the text's ``$names``; they have priority over DEFAULT statements.
    Raises :class:`SceneError` for any wrong input; a probable mistake is a :class:`SceneWarning`.
    """
    return document_of(text, filename, define).scene


def analyse(
    text: str, filename: str | PathLike[str] = "<string>", define: Mapping[str, object] | None = None
) -> tuple[Reader, list[SceneError | SceneWarning], Document | None]:
    """Reads a text; returns its reader, its errors and warnings in order, and the document if it has no error.

    Raises SceneError for a text that is too large.
    """
    if len(text) > SIZE_LIMIT:
        raise too_large(filename)
    with paused():
        reader = Reader(text, str(filename), define)
        undefined = [
            one for one in reader.definitions.undefined.values() if one.span and one.span.start < reader.skipped
        ]
        found: list[SceneError | SceneWarning] = [*reader.errors, *undefined, *reader.warnings]
        document = _document(reader)
        if not undefined and all(one.code == "no-end" for one in reader.errors):
            # Without END, statements may be missing.
            found += [one for one in _of_scene(document) if not reader.errors or isinstance(one, SceneError)]
        elif not undefined and reader.skipped == math.inf:
            found += _indices(document)
        found.sort(key=lambda problem: problem.span or Span(0, 0))
        if any(isinstance(problem, SceneError) for problem in found):
            return reader, found, None
        return reader, found, _resolved(document)


def _document(reader: Reader) -> Document:
    """The document of a text; if it has errors, with the valid fields only."""
    fields = {name: value for name, value in reader.fields.items() if name not in ("defaults", "solids")}
    for node in fields.get("csg", ()):
        for slot in node.textures if isinstance(node, Leaf) else ():
            if slot and slot.name in BUILT_IN:
                fields["patterns"].setdefault(slot.name, Pattern(BUILT_IN[slot.name]))
    fields.setdefault("name", PurePath(reader.source.filename).stem or "scene")
    scene = Scene(**fields, text=reader.source.text)
    return Document(reader.source, reader.spans, scene, frozenset(reader.definitions.uses))


def too_large(path: str | PathLike[str]) -> SceneError:
    """The error about a scene beyond :data:`SIZE_LIMIT`."""
    reason = f"the file is larger than {SIZE_LIMIT >> 20} MiB, the largest size of a scene"
    return SceneError(f"{path}: {reason}; write repeated solids by SOLID", str(path), reason=reason, code="size")


def _resolved(document: Document) -> Document:
    """The document with a separate index, SURFACE and TRANSFORM for each use of a part of a named solid.

    A part without a SURFACE has that of the solid around it; the steps of the part are applied first.
    """
    scene, spans = document.scene, dict(document.spans)
    surfaces, transforms, csg = scene.surfaces, scene.transforms, list(scene.csg)
    new_index: dict[tuple[int, ...], int] = {}
    free = count(max((*_used(document), *surfaces, *transforms), default=0) + 1)
    for number, leaf in enumerate(scene.csg):
        if not isinstance(leaf, Leaf) or not leaf.within:
            continue
        indices = leaf.index, *leaf.within
        if indices not in new_index:
            new_index[indices] = index = next(free)
            surface_index = next(i for i in indices if i in surfaces)
            surfaces[index] = surfaces[surface_index]
            transforms[index] = Transform(tuple(step for i in indices for step in transforms[i].steps))
            spans["surfaces", index] = spans["surfaces", surface_index]
            spans["transforms", index] = spans["transforms", indices[-1]]
        csg[number] = replace(leaf, index=new_index[indices], within=())
    return replace(document, scene=replace(scene, csg=tuple(csg)), spans=spans) if new_index else document


def _used(document: Document) -> set[int]:
    """The indices that the tree uses."""
    return {i for leaf in document.scene.csg if isinstance(leaf, Leaf) for i in (leaf.index, *leaf.within)}


# ---- A scene as a whole


def _of_scene(document: Document) -> Iterator[SceneError | SceneWarning]:
    """The errors and warnings about a scene as a whole."""
    for check in _settings, _lights, _materials, _kinds, _indices, _textures, _unused:
        yield from islice(check(document), MAX_ERRORS + 1)


def _settings(document: Document) -> Iterator[SceneError]:
    scene, name = document.scene, document.scene.name
    if not any(scene.channels):
        yield document.error("found FALSE for all channels; expected TRUE for one at least", "channels", code="range")
    allowed = name.isprintable() and len(name) <= 200 and not NO_NAME & {*name}
    if document.given("name") and (not allowed or name.strip() == "" or name in (".", "..")):
        reason = f"found {quote(name)}; expected the base name of a file: without a folder, 200 characters at most"
        yield document.error(reason, "name", "text")
    if scene.view.resolution[0] * scene.view.resolution[1] > PIXELS:
        reason = f"these are too many pixels; expected {PIXELS} at most"
        yield document.error(reason, "view", "resolution", code="range")


def _lights(document: Document) -> Iterator[SceneError | SceneWarning]:
    scene = document.scene
    intensities: list[tuple[Vector, Path]] = [(scene.ambient, ("ambient",))]
    intensities += [(scene.background.color, ("background",))] * (scene.background.image is None)
    for number, light in enumerate(scene.lights):
        intensities.append((light.intensity, ("lights", number, "intensity")))
        if light.kind != "sky" and not document.given("lights", number, "position"):
            word = document.word("lights", number)
            reason = f"this {word} light has no position; expected it after {word}, such as position 0 20 10"
            yield document.error(reason, "lights", number, code="incomplete")
    for color, path in intensities:
        if 0 < max(color) < DARK:
            yield document.warning(f"this {document.word(*path)} is nearly dark; 65535 is 1.0", *path, code="dark")


def _materials(document: Document) -> Iterator[SceneError | SceneWarning]:
    for index, s in document.scene.surfaces.items():
        wrong = ""
        if s.material == "conductor" and (s.eta or s.k if s.metal else not (s.eta and s.k)):
            wrong = "a condutor has either a metal's name, or n-refr and k-abs; expected one of the two"
        elif s.material == "dielectric" and (s.eta or s.abbe if s.glass else not s.eta):
            wrong = "a dieletrico has either a glass's name, or n-refr; expected one of the two"
        elif s.material == "composite" and not s.eta:
            wrong = "a composto lacks its index; expected n-refr"
        elif s.material == "composite" and s.ks and max(map(sum, zip(s.kd or GREY, s.ks))) > 1 + 1e-6:
            wrong = "kd + ks is above 1 in a composto; expected s + d = 1 at most"
        if wrong:
            name = "glass" if s.glass else "metal"  # without a name the error points to the surface
            yield document.error(wrong, "surfaces", index, name, code="optics")
        path = "surfaces", index, "thickness"
        if s.material == "dielectric" and s.transmittance is None and document.given(*path):
            reason = f"{document.word(*path)} has no effect without transmitancia; add transmitancia"
            yield document.warning(reason, *path, code="no-effect")


def _kinds(document: Document) -> Iterator[SceneError | SceneWarning]:
    """Errors about textures without a kind, and about parameters that a kind does not have."""
    for key, pattern in document.scene.patterns.items():
        if not pattern.kind:
            reason = f"the texture {quote(key)} has no kind; expected brick, stripes or fractal after its name"
            yield document.error(reason + nearest(key, BUILT_IN), "patterns", key, code="incomplete")
    for path in document.spans:
        field = str(path[0])
        of = LIMITED.get((field, str(path[2]))) if len(path) == 3 else None
        if of is None:
            continue
        kind = getattr(getattr(document.scene, field)[path[1]], KIND_OF[field]) or "phong" * (field == "surfaces")
        if kind and kind not in of:
            reason = f"{document.word(*path)} has no effect on {KINDS[kind]}; it is for {listing(KINDS[k] for k in of)}"
            diagnostic = document.error if field == "patterns" else document.warning
            yield diagnostic(reason, *path, code="unexpected" if field == "patterns" else "no-effect")


def _indices(document: Document) -> Iterator[SceneError]:
    """Errors about primitives without SURFACE or TRANSFORM, one for each index."""
    given = [path for path in document.spans if len(path) == 2]
    surfaces, transforms = ({key for field, key in given if field == wanted} for wanted in ("surfaces", "transforms"))
    reported = set()
    for number, leaf in enumerate(document.scene.csg):
        if not isinstance(leaf, Leaf) or (leaf.index, leaf.within) in reported:
            continue
        reported.add((leaf.index, leaf.within))
        indices = leaf.index, *leaf.within
        lack = [listing(f"SURFACE {i}" for i in indices)] * surfaces.isdisjoint(indices)
        lack += [f"TRANSFORM {i}" for i in indices if i not in transforms]
        if lack:
            reason = f"{leaf.shape.upper()} {leaf.index}{' in this solid' * bool(leaf.within)} has no "
            known = [f"SURFACE {i}" for i in sorted(surfaces)[:9]] + [f"TRANSFORM {i}" for i in sorted(transforms)[:9]]
            reason += f"{' and no '.join(lack)}; expected one; there are {listing(known or ['none'], 'and')}"
            yield document.error(reason, "csg", number, code="no-index")


def _textures(document: Document) -> Iterator[SceneError]:
    scene, reported = document.scene, set[str]()
    for number, leaf in enumerate(scene.csg):
        for slot, texture in enumerate(leaf.textures if isinstance(leaf, Leaf) else ()):
            path = "csg", number, "textures", slot
            if texture and texture.name and texture.name not in scene.patterns and texture.name not in reported:
                reported.add(texture.name)
                names = list(dict.fromkeys([*BUILT_IN, *scene.patterns]))
                reason = f"unknown texture {quote(texture.name)}; expected {listing(names[:20])}, an image file or NULL"
                yield document.error(reason + nearest(texture.name, [*names, *ALIASES]), *path, code="unknown-name")
            if slot == 1 and texture and texture.image:
                reason = "the second texture slot is solid and takes no image; expected it in the first"
                yield document.error(reason, *path, code="texture")


def _unused(document: Document) -> Iterator[SceneWarning]:
    """Warnings about unused values and missing statements."""
    scene, used = document.scene, _used(document)
    for field in "surfaces", "transforms":
        for index in getattr(scene, field):
            if index not in used:
                reason = f"{document.word(field, index)} {index} is not used: no primitive has this index; delete it"
                yield document.warning(reason, field, index, code="unused")
    for path in document.spans:
        if path[0] == "defaults" and path[1] not in document.uses:
            reason = f"nothing below uses ${path[1]}; delete this statement, or use the name"
            yield document.warning(reason, *path, code="unused")
    if not scene.csg:
        reason = f"the scene has no {canonical('CSG_TREE')}: only the background is visible; add the tree of its solids"
        yield document.warning(reason, "csg", code="no-tree")
    if not scene.lights:
        yield document.warning("the scene has no lights; add LIGHTS", "lights", code="no-lights")
