"""A text that has been read -> all that is wrong and doubtful in it, and the document if it is right."""

import re
import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import count, islice
from os import PathLike
from pathlib import PurePath

from ..collector import paused
from ..model import Leaf, Operator, Pattern, Scene, Transform, Vector
from .diagnostics import MOST, Diagnostic, SceneError, SceneWarning, Span, listing, quote, together
from .document import Document
from .reader import Reader, Skipped
from .suggestions import nearest
from .words import ALIASES, BUILT_IN, STATEMENTS, is_statement, normalise, spellings

#: Larger texts are refused: a scene of 10,000 primitives has about 2 MiB.
SIZE_LIMIT = 16 * 2**20
#: Below this, the intensity of a light, of AMBIENT or of BACKGROUND is most likely a mistake.
DARK = 256
BEGINNINGS = spellings(*STATEMENTS)
ENDS = [normalise(spelling) for spelling in spellings("END")]
VARIABLE = re.compile(r"\$(\w+)")
WORD, INDEX = re.compile(r"[^\s()#\":=]+"), re.compile(r"(?<![\w.])[0-9]{1,9}(?![\w.])")
LAST = re.compile(r"(?<!\S)(\S+)\s*\Z")


def document_of(
    text: str, filename: str | PathLike[str] = "<string>", define: Mapping[str, object] | None = None
) -> Document:
    """The scene that ``text`` describes, with the places of its values; raises and warns as :func:`parse` does."""
    reader, found, document = analyse(text, filename, define)
    for one in found:
        if not one.error:
            span = Span(one.start, one.end)
            message = reader.source.message(span, one.reason)
            warnings.warn(SceneWarning(message, one.reason, span, one.code), stacklevel=2)
    if document is None:
        wrong = errors(reader, found)
        raise together(wrong[0], wrong[1:])
    reader.definitions.check_uses()
    return document


def parse(text: str, filename: str | PathLike[str] = "<string>", define: Mapping[str, object] | None = None) -> Scene:
    """The scene that ``text`` describes, as a :class:`~prosim_scene.model.Scene`.

    ``define``: values, numbers or words, of the text's ``$names``; they go before those of DEFAULT statements.
    Raises :class:`SceneError` for any wrong input; what is only doubtful is a :class:`SceneWarning`.
    """
    return document_of(text, filename, define).scene


def analyse(
    text: str,
    filename: str | PathLike[str] = "<string>",
    define: Mapping[str, object] | None = None,
    tolerant: bool = False,
) -> tuple[Reader, list[Diagnostic], Document | None]:
    """A text, read; all its diagnostics, in the order of their places; and the document, if there is no error.

    Raises SceneError for what cannot be read at all.
    """
    if len(text) > SIZE_LIMIT:
        raise too_large(filename)
    with paused():
        reader = Reader(text, str(filename), define, tolerant)
        return reader, *_analyse(reader)


def _analyse(reader: Reader) -> tuple[list[Diagnostic], Document | None]:
    result = list(reader.diagnostics)
    document = None
    if any(one.error for one in result):
        if not reader.cut:
            starts = {one.start for one in result if one.error}
            result += [one for one in _lacking_behind_errors(reader) if one.start not in starts]
            result += _end(reader)
    else:
        used, within = _resolve(reader)
        document = _document(reader)
        end = _end(reader)
        of_all = [*within, *_of_scene(document, used), *_unused_names(reader)]
        # Without END, more may be missing than that.
        result += [*end, *(one for one in of_all if one.error or not end)]
    result.sort(key=lambda one: one.start)
    return result, None if any(one.error for one in result) else document


def errors(reader: Reader, found: Sequence[Diagnostic]) -> list[SceneError]:
    """The errors among the diagnostics, without those about names that have no value because of another error."""
    result: list[SceneError] = []
    known, hidden = set[str](), False
    for one in found:
        name = one.undefined
        if len(result) > MOST:
            break
        if not one.error or (name and (hidden or name in known)):
            continue
        result.append(reader.source.error(Span(one.start, one.end), one.reason, one.code))
        if name:
            known.add(name)
        for skipped in reader.skipped:
            if skipped.error is one and not name:
                known |= set(VARIABLE.findall(reader.source.text, skipped.start, skipped.end))
                hidden = hidden or skipped.role == "DEFAULT"
    return result


def _document(reader: Reader) -> Document:
    """The document of a text without errors within its statements."""
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
    return SceneError(
        f"{path}: the file is larger than {SIZE_LIMIT >> 20} MiB, the most that a scene may have", str(path)
    )


# ---- A scene as a whole


def _resolve(reader: Reader) -> tuple[set[int], list[Diagnostic]]:
    """Gives each use of a part of a named solid an index of its own, with its SURFACE and its TRANSFORM.

    The surface is that of the part, or else of the solid around it; the steps of the part come first. Returns all
    indices that the text uses, and the errors about those that lack something.
    """
    fields, spans = reader.fields, reader.spans
    surfaces, transforms, csg = fields["surfaces"], fields["transforms"], list(fields.get("csg", ()))
    leaves = [(number, leaf) for number, leaf in enumerate(csg) if isinstance(leaf, Leaf)]
    used = {index for _, leaf in leaves for index in (leaf.index, *leaf.within)}
    found: list[Diagnostic] = []
    own: dict[tuple[int, ...], int] = {}
    free = count(max((*used, *surfaces, *transforms), default=0) + 1)
    for number, leaf in leaves:
        indices = leaf.index, *leaf.within
        if not leaf.within:
            continue
        if indices not in own:
            own[indices] = index = next(free)
            looks = [i for i in indices if i in surfaces]
            lack = [f"TRANSFORM {i}" for i in indices if i not in transforms]
            lack += [] if looks else [listing(f"SURFACE {i}" for i in indices)]
            if lack:
                reason = f"{leaf.shape.upper()} {leaf.index} in this solid has no {' and no '.join(lack)}"
                found.append(reader.source.diagnostic(spans["csg", number], reason, "no-index", error=True))
                continue
            surfaces[index] = surfaces[looks[0]]
            transforms[index] = Transform(tuple(step for i in indices for step in transforms[i].steps))
            spans["surfaces", index] = spans["surfaces", looks[0]]
            spans["transforms", index] = spans["transforms", indices[-1]]
        csg[number] = replace(leaf, index=own[indices], within=())
    fields["csg"] = tuple(csg)
    return used, found


def _of_scene(document: Document, used: set[int]) -> Iterator[Diagnostic]:
    """What is wrong and what is doubtful in a scene as a whole."""
    yield from islice(_indices(document), MOST + 1)
    yield from islice(_textures(document), MOST + 1)
    yield from _unused(document, used)
    yield from _dark(document)


def lacking(
    csg: Sequence[Operator | Leaf], surfaces: Collection[int], transforms: Collection[int]
) -> Iterator[tuple[int, str]]:
    """The leaves without SURFACE or TRANSFORM, one for each index: their numbers in the tree, and what they lack."""
    told = set()
    for number, leaf in enumerate(csg):
        if not isinstance(leaf, Leaf) or leaf.within or leaf.index in told:
            continue
        tables = (surfaces, f"SURFACE {leaf.index}"), (transforms, f"TRANSFORM {leaf.index}")
        missing = [name for table, name in tables if leaf.index not in table]
        if missing:
            told.add(leaf.index)
            yield (
                number,
                f"{leaf.shape.upper()} {leaf.index} has no {' and no '.join(missing)}; expected "
                + (f"a statement {missing[0]}" if len(missing) == 1 else f"statements {' and '.join(missing)}"),
            )


def _indices(document: Document) -> Iterator[Diagnostic]:
    scene = document.scene
    for i, (number, reason) in enumerate(lacking(scene.csg, scene.surfaces, scene.transforms)):
        given = sorted(scene.surfaces if "SURFACE" in reason else scene.transforms) if i == 0 else []
        known = f"; there are {listing(given[:20], 'and')}" if given else ""
        yield document.diagnostic(reason + known, "no-index", "csg", number, error=True)


def _textures(document: Document) -> Iterator[Diagnostic]:
    scene = document.scene
    told: set[str] = set()
    for number, leaf in enumerate(scene.csg):
        if not isinstance(leaf, Leaf) or leaf.textures == (None, None):
            continue
        for slot, texture in enumerate(leaf.textures):
            path = "csg", number, "textures", slot
            if texture and texture.name and texture.name not in (*scene.patterns, *told):
                told.add(texture.name)
                names = list(dict.fromkeys([*BUILT_IN, *scene.patterns]))
                yield document.diagnostic(
                    f"unknown texture {quote(texture.name)}; expected {listing(names[:20])}, an image file "
                    f"or NULL{nearest(texture.name, [*names, *ALIASES])}",
                    "unknown-name",
                    *path,
                    error=True,
                )
            if slot == 1 and texture and texture.image:
                reason = "an image stands in the second texture slot, which is solid; expected it in the first"
                yield document.diagnostic(reason, "texture", *path, error=True)


def _dark(document: Document) -> Iterator[Diagnostic]:
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
            yield document.diagnostic(f"this {word} is all but dark: 65535 is 1.0", "dark", *path)


def _unused(document: Document, used: set[int]) -> Iterator[Diagnostic]:
    """What is given and never used, and what is missing."""
    scene = document.scene
    used = used | {node.index for node in scene.csg if isinstance(node, Leaf)}
    for name, table in (("surfaces", scene.surfaces), ("transforms", scene.transforms)):
        for index in table:
            if index not in used:
                reason = f"{document.word(name, index)} {index} is not used: no primitive has this index"
                yield document.diagnostic(reason, "unused", name, index)
    if not scene.csg:
        yield document.diagnostic("the scene has no CSG-TREE: nothing but the background is seen", "no-tree", "csg")
    if not scene.lights:
        yield document.diagnostic("the scene has no lights", "no-lights", "lights")


def _unused_names(reader: Reader) -> Iterator[Diagnostic]:
    """The names that nothing uses."""
    for name in reader.fields["defaults"]:
        if name not in reader.definitions.uses:
            yield reader.source.diagnostic(reader.spans["defaults", name], f"nothing below uses ${name}", "unused")


# ---- Behind errors: what was skipped may have been anything


def _lacking_behind_errors(reader: Reader) -> list[Diagnostic]:
    """The errors about primitives without SURFACE or TRANSFORM, unless what was skipped may have been these."""
    given = [*reader.spans, *(skipped.path for skipped in reader.skipped if skipped.path)]
    surfaces, transforms = ({int(p[1]) for p in given if p[0] == table} for table in ("surfaces", "transforms"))
    for skipped in reader.skipped:
        if skipped.role in ("SURFACE", "TRANSFORM") and not skipped.path:
            return []  # any index may have been meant
        if _may_hide_statements(reader, skipped):
            indices = {int(n) for n in INDEX.findall(reader.source.text, skipped.start, skipped.end)}
            surfaces |= indices
            transforms |= indices
    missing = islice(lacking(reader.fields.get("csg", ()), surfaces, transforms), MOST + 1)
    return [reader.source.diagnostic(reader.spans["csg", number], why, "no-index", True) for number, why in missing]


def _may_hide_statements(reader: Reader, skipped: Skipped) -> bool:
    """Whether what was skipped may be, or may hold, the beginning of another statement."""
    if not skipped.path:
        return True
    text, start = reader.source.text, skipped.error.start
    words = WORD.findall(text, start, skipped.end)
    begins = not text[text.rfind("\n", 0, start) + 1 : start].strip()
    return begins or any(map(is_statement, words)) or bool(nearest(" ".join(words[:1]), BEGINNINGS))


def _end(reader: Reader) -> list[Diagnostic]:
    """The error about a missing END, unless what was skipped can have been meant for it."""
    if reader.token.role == "END":
        return []
    text = reader.source.text
    found = LAST.search(text)
    tokens = (token for token in reversed(reader.tokens) if token.role != "COMMENT")
    last = next((token.span for token in tokens), Span(0, 0))
    if reader.skipped and found:  # the tokens may end at an error
        last = Span(*found.span(1))
    for skipped in reader.skipped:
        words = WORD.findall(text, skipped.error.start, skipped.end)
        meant = any(normalise(word) in ENDS for word in words) or nearest("".join(words[:1]), ENDS)
        if meant or skipped.error.start == last.start:
            return []
    reason = "the file ends here and END is missing; expected END as the last statement"
    return [reader.source.diagnostic(last, reason, "no-end", error=True)]
