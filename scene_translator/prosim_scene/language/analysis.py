"""Analyses the text of a scene: finds all errors and warnings, and returns the document if there is no error."""

import gc
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from itertools import count, islice
from pathlib import PurePath
from typing import Any

from ..model import GREY, Scene, Transform, Vector
from .diagnostics import MAX_ERRORS, AnyPath, Problem, SceneError, SceneWarning, Span, combined_error, listing, quote
from .document import Document, Path
from .reader import Reader
from .suggestions import nearest
from .words import ALIASES, BUILT_IN, KINDS, PIXELS, WORDS, words_of

#: The largest size of the text of a scene in bytes; a scene of 10,000 primitives has about 2 MiB.
SIZE_LIMIT = 4 * 2**20
#: A light, an AMBIENT or a BACKGROUND below this intensity causes a warning.
DARK = 256
#: (field of the model, parameter) -> the kinds of lights, materials or textures that have this parameter.
#: A parameter that all kinds have is not in this table.
LIMITED = {(words_of(word.statement)[0].name, word.name): word.kinds for word in WORDS if word.kinds}
#: Field of the model -> the attribute of its values that tells their kind.
KIND_OF = {"lights": "distribution", "surfaces": "material", "patterns": "kind"}


@contextmanager
def garbage_collection_paused() -> Iterator[None]:
    """Pauses Python's garbage collection during a ``with`` statement or a decorated function.

    Garbage collection would take a third of the time in which a scene is read, and free nothing, because the new
    objects have no reference cycles.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def document_of(text: str, filename: AnyPath = "<string>", define: Mapping[str, object] | None = None) -> Document:
    """Does what :func:`parse` does, but returns a document: the scene, and the position of each value in ``text``."""
    reader, problems, document = analyse(text, filename, define)
    for problem in problems:
        if isinstance(problem, SceneWarning):
            problem.emit()
    if document is None:
        raise combined_error([problem for problem in problems if isinstance(problem, SceneError)])
    reader.definitions.check_uses()
    return document


def parse(text: str, filename: AnyPath = "<string>", define: Mapping[str, object] | None = None) -> Scene:
    """Returns the scene that ``text`` describes, as a :class:`~prosim_scene.model.Scene`.

    ``define`` sets values (numbers or words) of the text's ``$names``; these values override DEFAULT statements. Raises
    :class:`SceneError` for any wrong input; emits a :class:`SceneWarning` for a probable mistake.
    """
    return document_of(text, filename, define).scene


def analyse(
    text: str, filename: AnyPath = "<string>", define: Mapping[str, object] | None = None
) -> tuple[Reader, list[Problem], Document | None]:
    """Reads a text and checks the scene; returns ``(reader, problems, document)``.

    ``problems`` are the errors and warnings in the order of the text. The document is None if the text has an error. If
    the reader finds errors or undefined names, most checks of the whole scene are left out, because they would report
    consequences of these errors. A text of more than SIZE_LIMIT characters is not read. Raises SceneError for a wrong
    name or value in ``define``.
    """
    if len(text) > SIZE_LIMIT:
        return Reader("", str(filename), define), [too_large(filename)], None
    with garbage_collection_paused():
        reader = Reader(text, str(filename), define)
        errors = reader.definitions.undefined.values()
        # A skipped statement may be the DEFAULT of a name that stands below it.
        undefined = [error for error in errors if error.span and error.span.start < reader.skipped]
        problems: list[Problem] = [*reader.errors, *undefined, *reader.warnings]
        # If there are errors, values in this document are missing or None.
        fields: dict[str, Any] = {"name": PurePath(filename).stem or "scene"} | reader.fields
        del fields["solids"]
        document = Document(reader.source, reader.spans, Scene(**fields), frozenset(reader.definitions.uses))
        if not undefined and all(error.code == "no-end" for error in reader.errors):
            # Without END, statements may be missing, so warnings about the whole scene are left out.
            problems += [one for one in _scene_problems(document) if not reader.errors or isinstance(one, SceneError)]
        elif not undefined and reader.skipped == math.inf:  # other checks would report consequences of the errors
            problems += _indices_problems(document)
        problems.sort(key=lambda problem: problem.span or Span(0, 0))
        wrong = any(isinstance(problem, SceneError) for problem in problems)
        return reader, problems, None if wrong else _with_separate_indices(document)


def too_large(path: AnyPath) -> SceneError:
    """Returns the error about a scene file that is larger than :data:`SIZE_LIMIT`."""
    return SceneError(f"the file is larger than {SIZE_LIMIT >> 20} MiB; write repeated solids by SOLID", path, "size")


def _with_separate_indices(document: Document) -> Document:
    """Returns a document in which the primitives of named solids have indices of their own."""
    scene, spans = document.scene, dict(document.spans)
    surfaces, transforms, csg = dict(scene.surfaces), dict(scene.transforms), list(scene.csg)
    new_index: dict[tuple[int, ...], int] = {}
    free = count(max((*_used_indices(scene), *surfaces, *transforms), default=0) + 1)
    for number, leaf in scene.leaves:
        indices = leaf.index, *leaf.within  # of the primitive, and of the named solids around it
        if not leaf.within:
            continue
        if indices not in new_index:
            new_index[indices] = index = next(free)
            surface_index = next(i for i in indices if i in surfaces)  # the innermost SURFACE has an effect
            surfaces[index] = surfaces[surface_index]
            transforms[index] = Transform(tuple(step for i in indices for step in transforms[i].steps))
            spans["surfaces", index] = spans["surfaces", surface_index]
            spans["transforms", index] = spans["transforms", indices[-1]]
        csg[number] = replace(leaf, index=new_index[indices], within=())
    separate = replace(scene, csg=tuple(csg), surfaces=surfaces, transforms=transforms)
    return replace(document, scene=separate, spans=spans) if new_index else document


def _used_indices(scene: Scene) -> set[int]:
    return {index for _, leaf in scene.leaves for index in (leaf.index, *leaf.within)}


# ---- Checks that need the whole scene


def _scene_problems(document: Document) -> Iterator[Problem]:
    """Yields what only a check of the whole scene finds; each check at most MAX_ERRORS + 1."""
    values = _settings_problems, _lights_problems, _materials_problems, _kinds_problems
    for problems in *values, _indices_problems, _textures_problems, _unused_warnings:
        yield from islice(problems(document), MAX_ERRORS + 1)


def _settings_problems(document: Document) -> Iterator[Problem]:
    scene = document.scene
    if not any(scene.channels):
        yield document.error("found FALSE for all channels; expected TRUE for one at least", "channels", code="range")
    if scene.view.resolution[0] * scene.view.resolution[1] > PIXELS:
        yield document.error(f"too many pixels; expected {PIXELS} at most", "view", "resolution", code="range")
    if scene.view.focus is not None and not scene.view.aperture:
        yield document.warning("FOCUS has no effect without APERTURE; add it", "view", "focus", code="no-effect")


def _lights_problems(document: Document) -> Iterator[Problem]:
    scene = document.scene
    intensities: list[tuple[Vector, Path]] = [(scene.ambient, ("ambient",))]
    intensities += [(scene.background.color, ("background",))] * (scene.background.image is None)
    for number, light in enumerate(scene.lights):
        intensities.append((light.intensity, ("lights", number, "intensity")))
        if light.kind != "sky" and not document.is_given("lights", number, "position"):
            reason = "this light has no position; expected one, such as position 0 20 10"
            yield document.error(reason, "lights", number, code="incomplete")
    for color, path in intensities:
        if 0 < max(color) < DARK:
            yield document.warning(f"this {document.text_of(*path)} is nearly dark; 65535 is 1.0", *path, code="dark")


def _materials_problems(document: Document) -> Iterator[Problem]:
    for index, s in document.scene.surfaces.items():
        wrong = ""
        if s.material == "conductor" and (s.eta or s.k if s.metal else not (s.eta and s.k)):
            wrong = "a conductor has either a metal's name, or n-refr and k-abs; expected one of the two"
        elif s.material == "dielectric" and (s.eta or s.abbe if s.glass else not s.eta):
            wrong = "a dielectric has either a glass's name, or n-refr; expected one of the two"
        elif s.material == "composite" and not s.eta:
            wrong = "this composite has no index of refraction; expected n-refr"
        elif s.material == "composite" and s.ks and max(map(sum, zip(s.kd or GREY, s.ks))) > 1 + 1e-6:
            wrong = "kd + ks is above 1 in a composite; expected a sum of 1 at most"
        if wrong:
            # The error points to the name of the metal or glass, or to the SURFACE if the text has no such name.
            name = "glass" if s.glass else "metal"
            yield document.error(wrong, "surfaces", index, name, code="optics")
        facets = s.material not in (None, "lambertian") and document.scene.method.facets == "gaussian"
        if facets and s.slope is not None and s.slope > 2:
            reason = "m is above 2, but with METHOD facets gaussian it is an angle in radians; expected 2 at most"
            yield document.error(reason, "surfaces", index, "slope", code="range")
        path = "surfaces", index, "thickness"
        if s.material == "dielectric" and s.transmittance is None and document.is_given(*path):
            yield document.warning("thickness has no effect without transmittance; add it", *path, code="no-effect")


def _kinds_problems(document: Document) -> Iterator[Problem]:
    for key, pattern in document.scene.patterns.items():
        if not pattern.kind:
            reason = f"the texture {quote(key)} has no kind; expected brick, stripes or fractal after its name"
            yield document.error(reason + nearest(key, BUILT_IN), "patterns", key, code="incomplete")
    for path in document.spans:
        field = str(path[0])
        # The path of a parameter has three parts: a field of the model, the key of a value there, the parameter.
        kinds = LIMITED.get((field, str(path[2]))) if len(path) == 3 else None
        if kinds is None:
            continue
        kind = getattr(getattr(document.scene, field)[path[1]], KIND_OF[field]) or "phong" * (field == "surfaces")
        if kind and kind not in kinds:
            names = listing(KINDS[kind] for kind in kinds)
            reason = f"{document.text_of(*path)} has no effect on {KINDS[kind]}; it is for {names}"
            diagnostic = document.error if field == "patterns" else document.warning
            yield diagnostic(reason, *path, code="unexpected" if field == "patterns" else "no-effect")


def _indices_problems(document: Document) -> Iterator[SceneError]:
    """Yields an error for each index of a primitive for which the scene has no SURFACE or no TRANSFORM."""
    statements = [path for path in document.spans if len(path) == 2]  # also of statements with an error
    surfaces, transforms = ({key for field, key in statements if field == name} for name in ("surfaces", "transforms"))
    reported = set()
    for number, leaf in document.scene.leaves:
        if (leaf.index, leaf.within) in reported or leaf.index < 0:  # -1: the statement has an error
            continue
        reported.add((leaf.index, leaf.within))
        indices = leaf.index, *leaf.within
        missing = [listing(f"SURFACE {i}" for i in indices)] * surfaces.isdisjoint(indices)
        missing += [f"TRANSFORM {i}" for i in indices if i not in transforms]
        if missing:
            reason = f"{leaf.shape.upper()} {leaf.index}{' in this solid' * bool(leaf.within)} has no "
            known = [f"SURFACE {i}" for i in sorted(surfaces)[:9]] + [f"TRANSFORM {i}" for i in sorted(transforms)[:9]]
            reason += f"{' and no '.join(missing)}; expected one; there are {listing(known or ['none'], 'and')}"
            yield document.error(reason, "csg", number, code="no-index")


def _textures_problems(document: Document) -> Iterator[SceneError]:
    names, reported = list(document.scene.patterns), set[str]()
    slots = ((number, *slot) for number, leaf in document.scene.leaves for slot in enumerate(leaf.textures))
    for number, slot, texture in slots:
        path = "csg", number, "textures", slot
        name = texture.name if texture else None
        if name and name not in document.scene.patterns and name not in reported:
            reported.add(name)
            reason = f"unknown texture {quote(name)}; expected {listing(names[:20])}, an image file or NULL"
            yield document.error(reason + nearest(name, [*names, *ALIASES]), *path, code="unknown-name")
        if slot == 1 and texture and texture.image:
            yield document.error("expected an image in the first texture slot, not the second", *path, code="texture")


def _unused_warnings(document: Document) -> Iterator[SceneWarning]:
    scene, used = document.scene, _used_indices(document.scene)
    reason = "no primitive has the index {}; delete this"
    if any(path[0] == "solids" for path in document.spans):  # a solid that is not used may have the index
        reason = "no primitive that CSG-TREE uses has the index {}; delete this, or use a solid with this index"
    for field in "surfaces", "transforms":
        for index in getattr(scene, field):
            if index not in used:
                yield document.warning(reason.format(index), field, index, code="unused")
    for path in document.spans:
        if path[0] == "defaults" and path[1] not in document.uses:
            yield document.warning(f"nothing below uses ${path[1]}; delete it, or use it", *path, code="unused")
    if not scene.csg:
        yield document.warning("the scene has no solids; add CSG-TREE", "csg", code="no-tree")
    if not scene.lights:
        yield document.warning("the scene has no lights; add LIGHTS", "lights", code="no-lights")
