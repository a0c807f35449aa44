"""Indices, textures and names: where they are said, where they are used, and others in their place."""

import re
from collections.abc import Iterator
from dataclasses import dataclass

from lark import Token

from ..language.definitions import FRAME, NAME, TIME
from ..language.names import ALIASES
from ..language.reading import Reading
from ..language.words import STATEMENTS, fold, numbers

#: The keywords that an index follows; those of the first two say what it means.
INDEXED = ("SURFACE", "TRANSFORM", "PRIMITIVE")
VARIABLE = re.compile(r"\$([A-Za-z_]\w*)", re.ASCII)


@dataclass(frozen=True)
class Symbol:
    """What has a name of its own: the ``kind`` is "index", "texture" or "name"."""

    kind: str
    key: str


@dataclass(frozen=True)
class Occurrence:
    """A place, offsets ``start`` to ``end``, where a symbol is used, or defined."""

    symbol: Symbol
    start: int
    end: int
    defines: bool


def occurrences(reading: Reading, symbol: Symbol | None = None, only: int | None = None) -> Iterator[Occurrence]:
    """Where symbols stand in a text, in order; all of them, or one; of all statements, or ``only`` of that number."""
    if symbol is not None and only is None:
        for number in _units(reading, symbol):
            yield from occurrences(reading, symbol, number)
        return
    text = reading.source.text
    before: Token | None = None
    for _, token, start in reading.tokens(only):
        if token.type in ("REMARK", "REST"):
            continue
        end = start + (token.end_pos or 0) - (token.start_pos or 0)
        for found in _in_token(token, before, text[start:end], start):
            if symbol is None or found.symbol == symbol:
                yield found
        before = token


def _units(reading: Reading, symbol: Symbol) -> Iterator[int]:
    """The numbers of the statements in which a symbol may stand: to look at the words of all takes seconds."""
    if symbol.kind == "texture":  # which has several spellings
        yield from range(len(reading.units))
        return
    # Before an index is a keyword, a mark of equality, the end of a remark or that of a line.
    index = rf"(?:^|[^\s\d.(])[^\S\n]*(?<!\d)0*{symbol.key}(?![\d.])"
    pattern = index if symbol.kind == "index" else rf"\${symbol.key}(?!\w)"
    last = -1
    for match in re.finditer(pattern, reading.source.text, re.ASCII | re.MULTILINE):
        number = reading.unit(match.end() - 1)
        if number is not None and number != last:
            last = number
            yield number


def at(reading: Reading, offset: int) -> Occurrence | None:
    """The symbol at an offset, or that ends there."""
    return next((o for o in occurrences(reading, only=reading.unit(offset)) if o.start <= offset <= o.end), None)


def definitions(reading: Reading, symbol: Symbol) -> list[Occurrence]:
    """Where a symbol is defined: an index by SURFACE and TRANSFORM."""
    return [o for o in occurrences(reading, symbol) if o.defines]


def renamed(reading: Reading, symbol: Symbol, new: str) -> list[Occurrence]:
    """The places in which ``new`` is to be written, so that a symbol has another name everywhere.

    Raises ValueError where that can't be a name, or is another's.
    """
    new = new.removeprefix("$") if symbol.kind == "name" else new
    if symbol.kind == "index":
        index = numbers("SURFACE", "surfaces")
        if not re.fullmatch(r"\d{1,9}", new):
            raise ValueError(f"{new!r} is no index; expected {index.bounds()}")
        new = str(int(new))
    elif symbol.kind == "texture":
        new = fold(new)
        if not re.fullmatch(r't-[^\s()#":={}]+', new):
            raise ValueError(f"{new!r} is no name of a texture; expected t- and a word")
    elif not NAME.fullmatch(new):
        raise ValueError(f"{new!r} cannot be a name; expected letters, digits and _")
    elif symbol.key in (FRAME, TIME):
        raise ValueError(f"${symbol.key} is the language's own name; expected another one to be renamed")
    if Symbol(symbol.kind, new) != symbol and any(occurrences(reading, Symbol(symbol.kind, new))):
        raise ValueError(f"{new!r} is there already; expected a new one")
    return list(occurrences(reading, symbol))


def _in_token(token: Token, before: Token | None, written: str, start: int) -> Iterator[Occurrence]:
    """The symbols in a token, as it is ``written`` at ``start``."""
    keyword = before.type if before is not None else ""
    if written[:1] in ("$", "{"):
        for match in VARIABLE.finditer(written):
            symbol = Symbol("name", match[1])
            yield Occurrence(symbol, start + match.start(), start + match.end(), token.type == "VARIABLE")
    elif token.type == "NUMBER" and keyword in INDEXED and re.fullmatch(r"\d{1,9}", written):
        yield Occurrence(Symbol("index", str(int(written))), start, start + len(written), keyword in STATEMENTS)
    elif token.type == "TEXTURE_NAME":
        name = fold(token)
        symbol = Symbol("texture", ALIASES.get(name, name))
        yield Occurrence(symbol, start, start + len(written), keyword == "TEXTURE")
