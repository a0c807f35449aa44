"""A text that changes -> its statements, each read on its own, and read anew only where it has changed.

The parser is in the same state before every statement. So what comes of a statement depends on its text alone, and on
what ``$names`` stand for; and an error in one does not hide the others.
"""

import re
import warnings
from bisect import bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from lark import Token, UnexpectedToken

from . import lexer, parentheses
from .automaton import Parser
from .builder import Builder
from .definitions import Definitions
from .document import Path
from .messages import Place, SceneError, SceneWarning, Source
from .parser import syntax_error
from .words import STATEMENTS, WORDS

#: Lines that begin with the keyword of a statement: where reading goes on after an error.
STATEMENT_LINE = re.compile(
    r"^[ \t]*(?:"
    + "|".join(
        sorted((re.escape(s) for w in WORDS if w.role in STATEMENTS for s in w.spellings), key=len, reverse=True)
    )
    + r")(?![\w.-])",
    re.IGNORECASE | re.MULTILINE,
)


@dataclass(frozen=True)
class Said:
    """An error or a warning, and where; ``start`` and ``end`` are offsets."""

    start: int
    end: int
    reason: str
    error: bool


@dataclass(eq=False)
class Unit:
    """A statement, up to the next one, with all offsets as they were when it was read at ``base``.

    ``tokens``: its pieces, remarks among them; ``fields`` and ``places``: what it says, if it is right; ``said``: what
    is said of it; ``uses`` and ``defines``: names, and what they stand for.
    """

    base: int
    end: int
    tokens: list[Token] = field(default_factory=list)
    fields: dict[str, Any] = field(default_factory=dict)
    places: dict[Path, Place] = field(default_factory=dict)
    said: list[Said] = field(default_factory=list)
    uses: dict[str, str | None] = field(default_factory=dict)
    defines: dict[str, str] = field(default_factory=dict)

    @property
    def keyword(self) -> Token | None:
        """The word that begins it."""
        return next((token for token in self.tokens if token.type in STATEMENTS), None)

    @property
    def wrong(self) -> bool:
        """Whether there is an error in it."""
        return any(said.error for said in self.said)


class Reading:
    """A text and its statements: ``units``, and where each of them is now, ``bases``. ``given``: see Definitions."""

    def __init__(self, text: str = "", filename: str = "<string>", given: Mapping[str, object] | None = None) -> None:
        self.source, self.given = Source("", filename), given
        self.units: list[Unit] = []
        self.bases: list[int] = []
        self.change(text)

    def change(self, text: str) -> None:
        """Another text in the place of the last one; what both have is not read again."""
        old, units, bases = self.source.text, self.units, self.bases
        same_start, same_end = _common(old, text)
        shift = len(text) - len(old)
        # Where units of the end begin now. The first of them has its keyword whole within what is the same.
        after = {
            base + shift: i for i, base in enumerate(bases) if base >= max(len(old) - same_end, same_start) and i > 0
        }
        self.source = Source(text, self.source.filename)
        self.units, self.bases = [], []
        definitions = Definitions(self.source, self.given)
        position = i = 0
        while position < len(text):
            # An unchanged unit ends before the change, and so does the keyword that follows it.
            if not (i < len(units) and bases[i] == position and _end(units, bases, i, old) <= same_start):
                i = after.get(position, len(units))
            # What is wrong may come to be right by what stands farther down, such as a remark that is closed there.
            if i < len(units) and not units[i].wrong and _means_the_same(units[i], definitions):
                unit = units[i]
                length = unit.end - unit.base
            else:
                unit = read(self.source, position, definitions)
                length = unit.end - position
            for name, value in unit.defines.items():
                definitions.default(name, value)
            self.units.append(unit)
            self.bases.append(position)
            position += length
            i += 1

    def unit(self, offset: int) -> int | None:
        """The number of the unit that an offset is in."""
        i = bisect_right(self.bases, offset) - 1
        return i if i >= 0 else None

    def tokens(self) -> Iterator[tuple[Unit, Token, int]]:
        """All tokens with their units, and their offsets."""
        for base, unit in zip(self.bases, self.units):
            for token in unit.tokens:
                yield unit, token, base + (token.start_pos or 0) - unit.base


def _common(old: str, new: str) -> tuple[int, int]:
    """How long the beginning is that two texts have in common, and the end behind that."""
    most = min(len(old), len(new))
    start = _longest(most, lambda n: old[:n] == new[:n])
    return start, _longest(most - start, lambda n: not n or old[-n:] == new[-n:])


def _longest(most: int, same: Any) -> int:
    """The largest n up to ``most`` for which ``same(n)`` holds, as it does for all smaller ones."""
    low, high = 0, most
    if same(most):
        return most
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if same(middle) else (low, middle)
    return low


def _end(units: list[Unit], bases: list[int], i: int, text: str) -> int:
    """Up to where the text decides what unit i is: the end of the keyword that follows it."""
    if i + 1 == len(units):
        return len(text) + 1
    following = units[i + 1].tokens
    return bases[i + 1] + (len(following[0]) + 1 if following else 1)


def _means_the_same(unit: Unit, definitions: Definitions) -> bool:
    """Whether the names that a unit uses stand for what they did."""
    return all(_value(definitions, name) == value for name, value in unit.uses.items())


def _value(definitions: Definitions, name: str) -> str | None:
    try:
        return definitions.text(name, Place(0, 0))
    except SceneError:
        return None


def read(source: Source, start: int, definitions: Definitions) -> Unit:
    """The unit that begins at ``start``."""
    unit = Unit(start, len(source.text))
    parser = Parser()
    definitions.uses = set()
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always", SceneWarning)
        try:
            for token in lexer.lex(source, parser.choices, definitions, start):
                if token.type in STATEMENTS and unit.keyword is not None and token.type in parser.choices():
                    unit.end = token.start_pos or 0
                    break
                unit.tokens.append(token)
                if token.type not in ("REMARK", "REST"):
                    parser.feed_token(token)
            _build(source, unit, parser)
        except UnexpectedToken as error:
            _fail(source, unit, syntax_error(source, error.token, parser.accepts(), unit.tokens))
        except SceneError as error:
            _fail(source, unit, error)
    for warning in warned:
        if isinstance(warning.message, SceneWarning):
            unit.said.append(said(warning.message))
    unit.uses = {name: _value(definitions, name) for name in definitions.uses}
    if unit.keyword is not None and unit.keyword.type == "DEFAULT" and not unit.wrong:
        words = [token for token in unit.tokens if token.type != "REMARK"]
        unit.defines = {str(words[1][1:]): str(words[2])}
    return unit


def _build(source: Source, unit: Unit, parser: Parser) -> None:
    """What a statement says, that the parser has been given all of."""
    keyword = unit.keyword
    if keyword is None:
        return  # nothing but remarks
    if keyword.type != "END":
        parser.feed_token(Token("END", "END", unit.end, end_pos=unit.end))
    tree = parser.feed_eof()
    parentheses.judge(source, unit.tokens, tree)
    builder = Builder(source)
    fields: dict[str, Any] = {"surfaces": {}, "transforms": {}, "patterns": {}}
    builder.statements(fields, tree)
    unit.fields, unit.places = fields, dict(builder.places)


def _fail(source: Source, unit: Unit, error: SceneError) -> None:
    """Records an error; what follows is read from the next line on that begins a statement."""
    found = said(error, unit.base)
    unit.said.append(found)
    if unit.end == len(source.text):
        after = STATEMENT_LINE.search(source.text, max(found.start + 1, unit.base + 1))
        unit.end = after.end() - len(after[0].lstrip()) if after else len(source.text)
        unit.tokens = [token for token in unit.tokens if (token.end_pos or 0) <= unit.end]


def said(message: SceneError | SceneWarning, otherwise: int = 0) -> Said:
    """What a message says; at ``otherwise`` where it has no place."""
    place = message.place or Place(otherwise, otherwise + 1)
    return Said(place.start, max(place.end, place.start + 1), message.reason, isinstance(message, SceneError))
