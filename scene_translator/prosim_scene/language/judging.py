"""Statements that were read one by one -> what is wrong and what is doubtful in the scene that they make."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import islice
from pathlib import PurePath
from typing import Any

from ..model import Leaf, Pattern, Scene
from . import checks, lexer
from .document import Document, Path
from .hints import nearest
from .messages import MOST, Place, Said, SceneError, Source
from .names import BUILT_IN
from .reading import Reading
from .units import Unit
from .words import STATEMENTS, canonical, fold, is_statement, of_role

BEGINNINGS = [spelling for role in STATEMENTS for row in of_role(role) for spelling in row.spellings]
ENDS = [fold(spelling) for row in of_role("END") for spelling in row.spellings]
VARIABLE = re.compile(r"\$(\w+)")
WORD, INDEX = re.compile(r"[^\s()#\":=]+"), re.compile(r"(?<![\w.])\d{1,9}(?![\w.])")
LAST = re.compile(r"(?<!\S)(\S+)\s*\Z")


class Places(Mapping[Path, Place]):
    """The places of all units, each moved to where it is now when it is asked for."""

    def __init__(self) -> None:
        self.where: dict[Path, tuple[int, Unit]] = {}

    def add(self, unit: Unit, base: int) -> bool:
        """Takes the places of a unit that begins at ``base``, but for one that says what another one has said."""
        if unit.path is None:
            return True
        return self.where.setdefault(unit.path, (base, unit))[1] is unit

    def get(self, path: Path, default: Any = None) -> Any:
        """The place of a value, if it is given."""
        base, unit = self.where.get(path) or self.where.get(path[:2]) or self.where.get(path[:1]) or (0, None)
        place = unit.place(path) if unit is not None else None
        if unit is None or place is None:
            return default
        return Place(place.start + base - unit.base, place.end + base - unit.base)

    def __getitem__(self, path: Path) -> Place:
        place: Place | None = self.get(path)
        if place is None:
            raise KeyError(path)
        return place

    def __contains__(self, path: object) -> bool:
        return isinstance(path, tuple) and self.get(path) is not None

    def __iter__(self) -> Iterator[Path]:
        return (path for _, unit in self.where.values() for path in unit.places)

    def __len__(self) -> int:
        return sum(1 for _ in self)


def judge(reading: Reading) -> tuple[list[Said], Document | None]:
    """What is said of a text, of all its statements, in order; and the document, if it is right."""
    result, twice = [], 0
    fields: dict[str, Any] = {"surfaces": {}, "transforms": {}, "patterns": {}}
    places = Places()
    for base, unit in zip(reading.bases, reading.units):
        if unit.said:
            shift = base - unit.base
            result += [replace(one, start=one.start + shift, end=one.end + shift) for one in unit.said]
        if not places.add(unit, base):
            twice += 1
            if twice <= MOST:
                result.append(_twice(reading.source, unit, base, places))
            continue
        for name, value in unit.fields.items():
            if isinstance(value, dict):
                fields[name].update(value)
            else:
                fields[name] = value
    document = None
    if any(one.error for one in result):
        if not reading.cut:
            starts = {one.start for one in result if one.error}
            result += [one for one in _lacking(reading, fields, places) if one.start not in starts]
            result += _end(reading)
    else:
        document = _document(reading, fields, places)
        end = _end(reading)
        of_all = [*checks.whole(document), *_unused(reading, document.uses)]
        # Without END it is not known what is yet to come.
        result += [*end, *(one for one in of_all if one.error or not end)]
    result.sort(key=lambda one: one.start)
    return result, None if any(one.error for one in result) else document


def errors(reading: Reading, found: list[Said]) -> list[SceneError]:
    """The errors among what was found, as far as they do not follow from one another."""
    result: list[SceneError] = []
    # Names that have no value because of an error above, or of which that is told already.
    said, hidden = set[str](), False
    for one in found:
        name = one.undefined
        if len(result) > MOST:
            break
        if not one.error or (name and (hidden or name in said)):
            continue
        result.append(reading.source.error(Place(one.start, one.end), one.reason, names=False))
        if name:
            said.add(name)
        elif (number := reading.unit(one.start)) is not None:
            base, unit = reading.bases[number], reading.units[number]
            said |= set(VARIABLE.findall(reading.source.text, base, base + unit.end - unit.base))
            hidden = hidden or unit.kind == "DEFAULT"
    return result


def _document(reading: Reading, fields: dict[str, Any], places: Places) -> Document:
    """The document of these values of a Scene's fields."""
    for node in fields.get("csg", ()):
        for slot in node.textures if isinstance(node, Leaf) else ():
            if slot and slot.name in BUILT_IN:
                fields["patterns"].setdefault(slot.name, Pattern(BUILT_IN[slot.name]))
    fields.setdefault("name", PurePath(reading.source.filename).stem or "scene")
    uses = frozenset(name for unit in reading.units if unit.uses for name in unit.uses)
    return Document(reading.source, places, Scene(**fields, text=reading.source.text), uses)


def _unused(reading: Reading, uses: frozenset[str]) -> Iterator[Said]:
    """The names that nothing uses."""
    for base, unit in zip(reading.bases, reading.units):
        for name in unit.defines:
            if name not in uses:
                place = unit.places["defaults", name]
                start, end = place.start + base - unit.base, place.end + base - unit.base
                yield reading.source.said(Place(start, end), f"nothing below uses ${name}")


def _lacking(reading: Reading, fields: Mapping[str, Any], places: Places) -> list[Said]:
    """The errors about primitives without SURFACE or TRANSFORM that no wrong statement can have been meant for."""
    surfaces, transforms = set(fields["surfaces"]), set(fields["transforms"])
    for base, unit in zip(reading.bases, reading.units):
        if not unit.wrong or any(unit.fields.values()):
            continue
        text = reading.source.text[base : base + unit.end - unit.base]
        error = _error(unit) - unit.base
        own = next((int(t) for t in unit.tokens if t.type == "NUMBER" and INDEX.fullmatch(t)), None)
        # What is wrong may be, or may hide, the beginning of another statement.
        begins = not text[text.rfind("\n", 0, error) + 1 : error].strip()
        words = WORD.findall(text, error)
        hiding = begins or any(map(is_statement, words)) or nearest(" ".join(words[:1]), BEGINNINGS)
        if hiding or own is None:
            numbers = {int(n) for n in INDEX.findall(text)}
            surfaces |= numbers
            transforms |= numbers
        elif unit.kind == "SURFACE":
            surfaces.add(own)
        elif unit.kind == "TRANSFORM":
            transforms.add(own)
    return [
        reading.source.said(places["csg", number], reason, error=True)
        for number, reason in islice(checks.lacking(fields.get("csg", ()), surfaces, transforms), MOST + 1)
    ]


def _twice(source: Source, unit: Unit, base: int, places: Places) -> Said:
    """The error about a statement that was given before."""
    path = unit.path or ()
    start, end = (at + base - unit.base for at in unit.places[path])
    keyword = source.text[start:end] if unit.kind == "SETTING" else canonical(unit.kind)
    what = " ".join([keyword, *(f"{'$' * (path[0] == 'defaults')}{index}" for index in path[1:2])])
    first = source.line(places[path])
    return Said(start, end, f"{what} is given twice; the first is on line {first}", True)


def _end(reading: Reading) -> list[Said]:
    """The error about a missing END, if nothing that is wrong can have been meant for it."""
    last = _last(reading)
    for base, unit in zip(reading.bases, reading.units):
        if unit.kind == "END":
            return []
        if unit.wrong:
            error = _error(unit) + base - unit.base
            words = WORD.findall(reading.source.text, error, base + unit.end - unit.base)
            if error == last.start or any(fold(word) in ENDS for word in words) or nearest("".join(words[:1]), ENDS):
                return []
    reason = "the file ends here and END is missing; expected END as the last statement"
    return [reading.source.said(last, reason, error=True)]


def _last(reading: Reading) -> Place:
    """The last word of a text."""
    for base, unit in zip(reversed(reading.bases), reversed(reading.units)):
        if unit.wrong and (found := LAST.search(reading.source.text)):  # it may have been read up to the error only
            return Place(found.start(), found.end(1))
        for token in reversed(unit.tokens):
            if token.type != "REMARK":
                return Place(lexer.place(token).start + base - unit.base, lexer.place(token).end + base - unit.base)
    return Place(0, 0)


def _error(unit: Unit) -> int:
    """Where the first error in a unit is."""
    return min(one.start for one in unit.said if one.error)
