"""Statements that were read one by one -> what is wrong and what is doubtful in the scene that they make."""

import re
import warnings
from collections.abc import Iterator, Mapping, MutableMapping
from typing import Any

from .builder import Builder
from .checks import lacking
from .document import Document, Path
from .hints import nearest
from .messages import Place, SceneError, SceneWarning, Source
from .reading import Reading, Said, Unit, said
from .words import STATEMENTS, is_statement, of_role

#: Longer texts are not read once more for the sake of a second error.
LONGEST = 2**16
BEGINNINGS = [spelling for role in STATEMENTS for row in of_role(role) for spelling in row.spellings]
UNDEFINED = "nothing above says what"
WORD, INDEX = re.compile(r"[^\s()#\":=]+"), re.compile(r"(?<![\w.])\d{1,9}(?![\w.])")


class Places(MutableMapping[Path, Place]):
    """The places of all units, each moved to where it is now when it is asked for."""

    def __init__(self) -> None:
        self.where: dict[Path, tuple[int, Place]] = {}

    def add(self, unit: Unit, base: int) -> None:
        """Takes the places of a unit that begins at ``base``."""
        shift = base - unit.base
        self.where.update({path: (shift, place) for path, place in unit.places.items()})

    def __getitem__(self, path: Path) -> Place:
        shift, place = self.where[path]
        return Place(place.start + shift, place.end + shift)

    def __setitem__(self, path: Path, place: Place) -> None:
        self.where[path] = 0, place

    def __delitem__(self, path: Path) -> None:
        del self.where[path]

    def __contains__(self, path: object) -> bool:
        return path in self.where

    def __iter__(self) -> Iterator[Path]:
        return iter(self.where)

    def __len__(self) -> int:
        return len(self.where)


def judge(reading: Reading) -> tuple[list[Said], Document | None]:
    """What is said of a text, as ``prosim_scene.parse`` would say it, but of all statements; and the document, if it is
    right.
    """
    result = [
        Said(one.start + base - unit.base, one.end + base - unit.base, one.reason, one.error)
        for base, unit in zip(reading.bases, reading.units)
        for one in unit.said
    ]
    fields: dict[str, Any] = {"surfaces": {}, "transforms": {}, "patterns": {}}
    builder = Builder(reading.source, frozenset(name for unit in reading.units for name in unit.uses))
    places = Places()
    for base, unit in zip(reading.bases, reading.units):
        if twice := _twice(reading.source, unit, base, places):
            result.append(twice)
            continue
        places.add(unit, base)
        for name, value in unit.fields.items():
            if isinstance(value, dict):
                fields[name].update(value)
            else:
                fields[name] = value
    if not any(one.error for one in result):
        result += _end(reading)
    document = None
    if not any(one.error for one in result):
        builder.places = places
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always", SceneWarning)
            try:
                document = builder.whole(fields)
            except SceneError as error:
                result.append(said(error))
        result += [said(w.message) for w in warned if isinstance(w.message, SceneWarning)]
    if document is None:
        starts = {one.start for one in result if one.error}
        result += [one for one in _lacking(reading, fields, places) if one.start not in starts]
    return result, document


def others(first: SceneError, text: str, filename: str, given: Mapping[str, object] | None) -> list[SceneError]:
    """The errors beside the first one of a text, as far as they do not follow from one another."""
    if first.place is None or len(text) > LONGEST:
        return []
    reading = Reading(text, filename, given)
    found = {one.start: one for one in judge(reading)[0] if one.error}
    if found.pop(first.place.start, None) is None:
        return []
    # A name lacks its value because of another error, or wherever it is used.
    return [
        reading.source.error(Place(start, one.end), one.reason)
        for start, one in sorted(found.items())
        if not one.reason.startswith(UNDEFINED)
    ]


def _lacking(reading: Reading, fields: Mapping[str, Any], places: Places) -> list[Said]:
    """The errors about primitives without SURFACE or TRANSFORM that no wrong statement can have been meant for."""
    surfaces, transforms = set(fields["surfaces"]), set(fields["transforms"])
    for base, unit in zip(reading.bases, reading.units):
        if not unit.wrong:
            continue
        text = reading.source.text[base : base + unit.end - unit.base]
        error = min(one.start for one in unit.said if one.error) - unit.base
        kind = "" if unit.keyword is None else unit.keyword.type
        own = next((int(t) for t in unit.tokens if t.type == "NUMBER" and INDEX.fullmatch(t)), None)
        # What is wrong may be, or may hide, the beginning of another statement.
        begins = not text[text.rfind("\n", 0, error) + 1 : error].strip()
        words = WORD.findall(text, error)
        hiding = begins or any(map(is_statement, words)) or nearest(" ".join(words[:1]), BEGINNINGS)
        if hiding or own is None:
            numbers = {int(n) for n in INDEX.findall(text)}
            surfaces |= numbers
            transforms |= numbers
        elif kind == "SURFACE":
            surfaces.add(own)
        elif kind == "TRANSFORM":
            transforms.add(own)
    return [
        said(reading.source.error(places["csg", number], reason))
        for number, reason in lacking(fields.get("csg", ()), surfaces, transforms)
    ]


def _twice(source: Source, unit: Unit, base: int, places: Places) -> Said | None:
    """The error about a statement that was given before."""
    path = next(iter(unit.places), None)
    if path is None or path not in places:
        return None
    keyword = unit.keyword
    assert keyword is not None
    what = " ".join([str(keyword), *(f"{'$' * (path[0] == 'defaults')}{index}" for index in path[1:2])])
    start = base + (keyword.start_pos or 0) - unit.base
    first = source.line(places[path])
    return Said(start, start + len(keyword), f"{what} is given twice; the first is on line {first}", True)


def _end(reading: Reading) -> list[Said]:
    """The error about a missing END."""
    keywords = [unit.keyword for unit in reading.units]
    if any(keyword is not None and keyword.type == "END" for keyword in keywords):
        return []
    ends = [(at, at + len(token)) for _, token, at in reading.tokens() if token.type != "REMARK"]
    start, end = ends[-1] if ends else (0, 1)
    return [Said(start, end, "the file ends here and END is missing; expected END as the last statement", True)]
