"""What may be written at a place in a text, and what stands there means."""

import re
from collections.abc import Iterator
from dataclasses import dataclass

from lark import Token, UnexpectedToken

from ..language.automaton import Parser
from ..language.definitions import FRAME, TIME
from ..language.expressions import CONSTANTS, FUNCTIONS
from ..language.names import BUILT_IN, GLASSES, INDICES, METALS
from ..language.parser import ORDER
from ..language.quantities import Numbers
from ..language.reading import Reading
from ..language.words import ROLES, STATEMENTS, Word, fold, of_role, row
from ..model import Leaf
from . import meanings, metals, places

#: The word before the cursor.
WORD = re.compile(r'[^\s()#":=]*\Z')
BRACES = re.compile(r"\{[^{}\n]*\Z")
IN_BRACES = re.compile(r"[$\w]*\Z")


@dataclass(frozen=True)
class Completion:
    """A word in the place of the text from ``start`` on; ``kind`` is that of what it is, ``detail`` what follows it.

    Those with the lowest ``rank`` come first.
    """

    label: str
    kind: str  # "statement", "keyword", "metal", "glass", "texture", "index", "name" or "function"
    start: int
    detail: str = ""
    documentation: str = ""
    rank: int = 0


def completions(reading: Reading, offset: int) -> list[Completion]:
    """The words that fit at an offset, whatever has been typed of one already."""
    text = reading.source.text
    line = text[text.rfind("\n", 0, offset) + 1 : offset]
    if braces := BRACES.search(line):
        start = offset - len((IN_BRACES.search(braces[0]) or braces)[0])
        return [*_names(reading, start), *_functions(start)]
    start = offset - len((WORD.search(line) or [""])[0])
    found = _before(reading, start)
    if found is None:
        return []
    expected, last = found
    if last is not None and last.type in places.INDEXED:
        return [*_indices(reading, last, start), *_names(reading, start)]
    if last is not None and last.type in ROLES and isinstance(row(last).takes, Numbers):
        return _names(reading, start)
    result = list(_words(expected, start))
    if last is not None and last.type in ("METAL", "CONDUCTOR"):
        result += [Completion(name, "metal", start, METALS[name], metals.described(name)) for name in METALS]
    if last is not None and last.type == "DIELECTRIC":
        result += [Completion(name, "glass", start) for name in GLASSES]
    if "TEXTURE_NAME" in expected:
        result += _textures(reading, start)
    if "VARIABLE" not in expected and {"NUMBER", "WORD"} & expected:
        result += _names(reading, start)
    return result


def hover(reading: Reading, offset: int) -> tuple[int, int, str] | None:
    """``(start, end, Markdown)`` of what is said of the word at an offset."""
    occurrence = places.at(reading, offset)
    number = reading.unit(offset)
    if occurrence is not None:
        return occurrence.start, occurrence.end, _of_symbol(reading, occurrence.symbol)
    if number is None:
        return None
    unit, base = reading.units[number], reading.bases[number]
    last = None
    for token in unit.tokens:
        start, end = (base + (at or 0) - unit.base for at in (token.start_pos, token.end_pos))
        if start <= offset < end:
            if token.type in ROLES and reading.source.text[start] != "$":
                return start, end, meanings.described(row(token))
            if token.type in meanings.OPERATORS:
                return start, end, meanings.OPERATORS[token.type]
            if token.type == "WORD" and last is not None and last.type in ("METAL", "CONDUCTOR"):
                known = fold(token) in METALS
                return start, end, metals.described(fold(token)) if known else "a metal that nobody knows"
            if token.type == "WORD" and last is not None and last.type == "DIELECTRIC" and fold(token) in GLASSES:
                name = GLASSES[fold(token)]
                return start, end, f"The glass {name}: n-refr = {INDICES[name]} at 587.6 nm"
        if token.type != "REMARK":
            last = token
    return None


def _before(reading: Reading, start: int) -> tuple[set[str], Token | None] | None:
    """What has a place at an offset, and the token before it; None in a remark and the like."""
    number = reading.unit(start)
    if number is not None and reading.bases[number] == start and number:
        number -= 1  # a keyword is what the statement before it may be followed by
    parser = Parser()
    last: Token | None = None
    unit = reading.units[number] if number is not None else None
    shift = reading.bases[number] - unit.base if unit is not None and number is not None else 0
    for token in unit.tokens if unit is not None else ():
        if (token.start_pos or 0) + shift >= start:
            break
        end = (token.end_pos or 0) + shift
        if end > start or token.type == "REST" or (end == start and token.startswith("#")):
            return None
        if token.type != "REMARK":
            try:
                parser.feed_token(token)
            except UnexpectedToken:
                break
            last = token
    return parser.accepts(), last


def _words(expected: set[str], start: int) -> Iterator[Completion]:
    """The keywords of the roles that have a place: those of the statement first, canonical spellings before others."""
    for role in ORDER:
        if role in ROLES and role in expected:
            for word in of_role(role):
                yield from _spellings(word, start, 2 if role in STATEMENTS else 0)


def _spellings(word: Word, start: int, rank: int) -> Iterator[Completion]:
    kind = "statement" if word.role in STATEMENTS else "keyword"
    for i, spelling in enumerate(word.spellings):
        yield Completion(spelling, kind, start, meanings.takes(word), meanings.described(word), rank + (i > 0))


def _indices(reading: Reading, keyword: Token, start: int) -> list[Completion]:
    """Indices that lack this statement; or for a primitive, those that have one."""
    given: dict[str, set[int]] = {kind: set() for kind in places.INDEXED}
    for number, unit in enumerate(reading.units):
        if unit.wrong:
            for one in places.occurrences(reading, only=number):
                if one.symbol.kind == "index":
                    given[unit.kind if one.defines else "PRIMITIVE"].add(int(one.symbol.key))
            continue
        given["SURFACE"].update(unit.fields.get("surfaces", ()))
        given["TRANSFORM"].update(unit.fields.get("transforms", ()))
        given["PRIMITIVE"].update(node.index for node in unit.fields.get("csg", ()) if isinstance(node, Leaf))
    if keyword.type == "PRIMITIVE":
        found = given["SURFACE"] | given["TRANSFORM"]
    else:
        found = (given["PRIMITIVE"] | given["SURFACE"] | given["TRANSFORM"]) - given[keyword.type]
    found = found or {max(set().union(*given.values()), default=-1) + 1}
    return [Completion(str(i), "index", start, rank=0) for i in sorted(found)]


def _textures(reading: Reading, start: int) -> list[Completion]:
    kinds = BUILT_IN | {n: p.kind for unit in reading.units for n, p in unit.fields.get("patterns", {}).items()}
    return [Completion(name, "texture", start, kind, meanings.TEXTURES[kind]) for name, kind in kinds.items()]


def _names(reading: Reading, start: int) -> list[Completion]:
    values = {FRAME: "the number of a frame", TIME: "its second"}
    values |= {name: value for unit in reading.units for name, value in unit.defines.items()}
    return [Completion(f"${name}", "name", start, value, rank=1) for name, value in values.items()]


def _functions(start: int) -> list[Completion]:
    return [Completion(name, "function", start, rank=2) for name in (*FUNCTIONS, *CONSTANTS)]


def _of_symbol(reading: Reading, symbol: places.Symbol) -> str:
    """What is said of an index, a texture or a name."""
    if symbol.kind == "name":
        values = {FRAME: "0", TIME: f"${FRAME} / 24"}
        values |= {name: value for unit in reading.units for name, value in unit.defines.items()}
        value = values.get(symbol.key)
        return f"**${symbol.key}**" + (f" = {value}" if value is not None else ": nothing here says what it stands for")
    if symbol.kind == "texture":
        patterns = {n: p.kind for unit in reading.units for n, p in unit.fields.get("patterns", {}).items()}
        kind = patterns.get(symbol.key) or BUILT_IN.get(symbol.key)
        return f"**{symbol.key}** " + (meanings.TEXTURES[kind] if kind else "no TEXTURE has this name")
    parts = []
    for unit in reading.units:
        for table in ("surfaces", "transforms"):
            if int(symbol.key) in unit.fields.get(table, {}):
                base = reading.bases[reading.units.index(unit)]
                parts.append(reading.source.text[base : base + unit.end - unit.base].strip())
    return "```scn\n" + "\n".join(parts) + "\n```" if parts else f"no SURFACE or TRANSFORM has the index {symbol.key}"
