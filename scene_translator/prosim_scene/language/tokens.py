"""Text -> tokens, and the values of ``$names``.

A word is a keyword only where the grammar has a place for it, so the reader says which roles it expects next.
"""

import math
import re
from collections.abc import Mapping
from functools import lru_cache
from numbers import Real
from typing import NamedTuple

from . import expressions
from .diagnostics import Diagnostic, SceneError, Source, Span, listing, quote
from .suggestions import NUMBER as NUMBER_PATTERN
from .suggestions import nearest, of_comment
from .words import MARKS, OPERATORS, ROLES, ROWS, STATEMENT_OF, canonical, normalise

#: What stands at a place, or behind the space that is there. What is most frequent comes first.
PIECE = re.compile(
    rf'\s*(?:(?P<number>{NUMBER_PATTERN})(?![^\s()#":=])|(?P<mark>[()]|[*+-](?![\d.]|inf|nan))'
    r'|(?P<word>[^\s()#":={$][^\s()#":=]*)|(?P<equals>[:=])|(?P<comment>\#[^\n]*)|(?P<expression>\{[^{}\n]*\}?)|(?P<name>\$[^\s()#":=]*)|(?P<string>"[^"\n]*"?))',
    re.IGNORECASE,
)
#: A plain number, where numbers follow one another.
NEXT_NUMBER = re.compile(rf'\s*({NUMBER_PATTERN})(?![^\s()#":=])', re.IGNORECASE)
PARENTHESIS = re.compile(r"[()]")
NUMBER = re.compile(NUMBER_PATTERN, re.IGNORECASE)
#: A name, without its ``$``.
NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)
#: The names that have values of their own: the number of a frame in a film, and its second.
FRAME, TIME = "frame", "time"
#: Frames a second where the user says nothing else: those of the cinema.
FPS = 24.0
#: What a name may stand for: a word that begins nothing.
VALUES = frozenset(
    ("NUMBER", "WORD", "FILE", "TEXTURE_NAME", "BOOL", "NULL", "MATERIAL_KIND", "CONDUCTOR", "DIELECTRIC", "KIND")
)
#: What a name without a value is read as, where its value does not matter: the first of these that fits.
ANY = ("NUMBER", "WORD", *sorted(VALUES))


class Token(NamedTuple):
    """A piece of the text from ``start`` to ``end``.

    ``role``: what the grammar takes it for, COMMENT, REST (what follows END), EQUALS (a mark without a place), or
    ``""`` for the end of the text. ``text``: what it says: the value of a name or an expression, a string without its
    quotes.
    """

    role: str
    text: str
    start: int
    end: int

    @property
    def span(self) -> Span:
        """Where it stands."""
        return Span(self.start, self.end)


class UndefinedError(SceneError):
    """A name has no value."""

    name = ""


class Definitions:
    """The values of ``$names`` in one text, and which of them it ``uses``.

    A name has the value ``given`` from outside (``-D`` of the commands, ``define`` in Python), or else that of the
    DEFAULT statement above its use. ``$frame`` and ``$time`` have values of their own. Raises SceneError for what
    cannot be a name or a value.
    """

    def __init__(self, source: Source, given: Mapping[str, object] | None = None) -> None:
        self.source = source
        self.given = {name: _checked(source, name, value) for name, value in (given or {}).items()}
        self.defaults: dict[str, str] = {}
        self.uses: set[str] = set()
        source.names.update({name: f"{quote(text)}, by -D {name}={text}" for name, text in self.given.items()})

    def default(self, name: str, text: str) -> None:
        """Takes the value that a DEFAULT statement gives a name."""
        self.defaults[name] = text
        self.source.names.setdefault(name, quote(text))

    def text(self, name: str, span: Span) -> str:
        """The text that a name stands for; UndefinedError where it has none."""
        self.uses.add(name)
        for table in (self.given, self.defaults):
            if name in table:
                return table[name]
        if name == FRAME:
            return "0"
        if name == TIME:
            return written(self.number(FRAME, span) / FPS)
        known = [f"${other}" for other in dict.fromkeys([*self.given, *self.defaults, FRAME, TIME])]
        error = self.source.error(
            span,
            f"nothing above says what ${name} stands for; expected DEFAULT ${name} = 1 before its use, or a value from "
            f"without: -D {name}=1, define={{{name!r}: 1}} in Python{nearest('$' + name, known)}",
            "undefined",
        )
        undefined = UndefinedError(str(error), error.filename, error.line, error.column, error.reason, span, error.code)
        undefined.name = name
        raise undefined

    def number(self, name: str, span: Span) -> float:
        """The number that a name stands for; SceneError where it stands for something else, or for nothing."""
        text = self.text(name, span)
        if not NUMBER.fullmatch(text) or not math.isfinite(float(text)):
            value = self.source.names.get(name, quote(text))
            reason = f"${name} stands for {value}; expected a finite number in arithmetic"
            raise self.source.error(span, reason, "expression")
        return float(text)

    def check_uses(self) -> None:
        """Raises SceneError for a value from outside that the text, which has been read, does not use."""
        unused = [name for name in self.given if name not in self.uses | self.defaults.keys() | {FRAME, TIME}]
        if unused:
            name = unused[0]
            used = [f"${other}" for other in sorted(self.uses | self.defaults.keys())]
            there = f"it has {listing(used, 'and')}{nearest('$' + name, used)}" if used else "it has no names at all"
            raise SceneError(
                f"{self.source.filename}: {name} = {self.given[name]} is given, and nothing in the scene says ${name}; "
                + there,
                self.source.filename,
                code="unused-definition",
            )


class Scanner:
    """The tokens of a text, in order; ``tokens`` are all that have been read, comments included.

    ``tolerant``: names without values are read as whatever fits; ``undefined`` tells whether there were any.
    ``warnings`` are about comments that look like something else.
    """

    def __init__(self, source: Source, definitions: Definitions, tolerant: bool = False) -> None:
        self.source, self.definitions, self.tolerant = source, definitions, tolerant
        self.tokens: list[Token] = []
        self.warnings: list[Diagnostic] = []
        self.position = 0
        self.undefined = False
        self.last = Token("", "", 0, 0)  # the last one that is no comment

    def next(self, expected: frozenset[str], statement: str) -> Token:
        """The next token that is no comment; its role is one of the ``expected`` ones where that is possible.

        ``statement``: the role of the statement that the token stands in. Raises SceneError for marks that are not
        closed and for wrong expressions.
        """
        text, match = self.source.text, PIECE.match
        while found := match(text, self.position):
            kind = found.lastgroup or ""
            start, self.position = found.span(kind)
            piece = found[kind]
            if kind == "number":
                token = Token("NUMBER", piece, start, self.position)
            elif kind == "word":
                token = Token(role_of(piece, expected, statement), piece, start, self.position)
            elif kind == "mark" and (MARKS[piece] in expected or piece in OPERATORS):
                token = Token(MARKS[piece], piece, start, self.position)
            elif kind == "equals" and (self.last.role in ROLES or self.last.role == "VARIABLE"):
                continue
            elif kind == "comment" or piece == "(":
                self.tokens.append(self.comment(kind, start))
                continue
            else:
                token = self.other(kind, piece, Span(start, self.position), expected, statement)
            self.tokens.append(token)
            self.last = token
            return token
        return Token("", "", len(text), len(text))

    def plain_numbers(self) -> list[Token]:
        """The plain numbers from here on, which may be none; others, such as expressions, may follow."""
        text, match, tokens = self.source.text, NEXT_NUMBER.match, list[Token]()
        while found := match(text, self.position):
            start, self.position = found.span(1)
            tokens.append(Token("NUMBER", found[1], start, self.position))
        if tokens:
            self.tokens += tokens
            self.last = tokens[-1]
        return tokens

    def comment(self, kind: str, start: int) -> Token:
        """The comment that begins at ``start``."""
        if kind == "mark":
            self.position = self.end_of_comment(start)
        text = self.source.text[start : self.position]
        if kind == "comment" and (reason := of_comment(text)):
            self.warnings.append(self.source.diagnostic(Span(start, self.position), reason, "directive"))
        return Token("COMMENT", text, start, self.position)

    def end_of_comment(self, start: int) -> int:
        """The offset behind the parenthesis that closes the one at ``start``."""
        depth = 0
        for found in PARENTHESIS.finditer(self.source.text, start):
            depth += 1 if found[0] == "(" else -1
            if depth == 0:
                return found.end()
        raise self.source.error(Span(start, start + 1), "this remark is not closed; expected ')'", "unclosed")

    def other(self, kind: str, piece: str, span: Span, expected: frozenset[str], statement: str) -> Token:
        """The token of a less frequent kind."""
        if kind == "equals":
            return Token("EQUALS", piece, *span)
        if kind == "mark":
            raise self.source.error(span, "found ')' without its '('", "unclosed")
        if kind == "string":
            if len(piece) < 2 or piece[-1] != '"':
                raise self.source.error(span, "this quote is not closed on its line", "unclosed")
            return Token("STRING", piece[1:-1], *span)
        try:
            if kind == "expression":
                value = expressions.evaluate(self.source, span, self.definitions.number)
                return Token("NUMBER", written(value), *span)
            return self.name(piece, span, expected, statement)
        except UndefinedError:
            if not self.tolerant:
                raise
            self.undefined = True
            fitting = (role for role in ANY if role in expected)
            role = "NUMBER" if kind == "expression" else next(fitting, "WORD")
            text = canonical(role) if role in ROLES else "1" if role == "NUMBER" else piece
            return Token(role, text, *span)

    def name(self, name: str, span: Span, expected: frozenset[str], statement: str) -> Token:
        """The token of a ``$name``: itself after DEFAULT, and elsewhere the number or the word that it stands for."""
        if not NAME.fullmatch(name, 1):
            raise self.source.error(
                span,
                f"found {quote(name)}; expected letters, digits and _ after $, and arithmetic in braces: {{$x - 1}}",
                "name",
            )
        if "VARIABLE" in expected:
            return Token("VARIABLE", name, *span)
        text = self.definitions.text(name[1:], span)
        piece = PIECE.fullmatch(text)
        if piece is None or piece.lastgroup not in ("word", "number") or piece.start(piece.lastgroup) > 0:
            return Token("STRING", text, *span)
        role = "NUMBER" if piece.lastgroup == "number" else role_of(text, expected, statement)
        if role not in VALUES:
            value = self.source.names.get(name[1:], quote(text))
            reason = f"{name} stands for {value}, a keyword; expected a number, or a word that is a value"
            raise self.source.error(span, reason, "name")
        return Token(role, text, *span)

    def rest(self) -> None:
        """Reads what follows END: comments, and from anything else on one token REST."""
        text = self.source.text
        while found := PIECE.match(text, self.position):
            kind = str(found.lastgroup)
            start, self.position = found.span(kind)
            try:
                if kind == "comment" or found[kind] == "(":
                    self.tokens.append(self.comment(kind, start))
                    continue
            except SceneError:
                pass  # a parenthesis that nothing closes
            self.warnings.append(
                self.source.diagnostic(Span(start, self.position), "what follows END is ignored", "after-end")
            )
            self.tokens.append(Token("REST", text[start:], start, len(text)))
            return


@lru_cache(maxsize=1 << 12)
def role_of(word: str, expected: frozenset[str], statement: str) -> str:
    """The role of a word: the keyword that fits here, a name, or else whatever explains it best.

    Where the next statement may begin, a word may have two roles: that in the present statement goes before.
    """
    normal = normalise(word)
    roles = [row.role for row in ROWS.get(normal, ())]
    if fitting := [role for role in roles if role in expected]:
        return next((role for role in fitting if STATEMENT_OF.get(role) == statement), fitting[0])
    if normal.startswith("t-") and ("TEXTURE_NAME" in expected or "WORD" not in expected):
        return "TEXTURE_NAME"
    if "FILE" in expected and "." in word and any(c.isalpha() for c in word):
        return "FILE"
    if "WORD" in expected:
        return "WORD"
    return roles[0] if roles else "WORD"


def written(value: float) -> str:
    """A number as the language writes it, to the bit."""
    return str(int(value)) if abs(value) < 1e15 and value == int(value) else repr(value)


def _checked(source: Source, name: str, value: object) -> str:
    """The text of a value from outside."""
    if not NAME.fullmatch(name):
        raise SceneError(
            f"{source.filename}: {name!r} cannot be a name; expected letters, digits and _, such as angle_2",
            source.filename,
            code="name",
        )
    if isinstance(value, bool):
        text = str(value).upper()
    elif isinstance(value, Real):
        text = written(float(value)) if math.isfinite(value) else ""
    else:
        text = value.strip() if isinstance(value, str) else ""
    if not text or '"' in text or not text.isprintable():
        raise SceneError(
            f"{source.filename}: {name} = {value!r} cannot stand in a scene; expected a finite number or a word",
            source.filename,
            code="name",
        )
    return text
