"""Splits the text of a scene into tokens.

The same word may be a keyword in one statement and a name in another, so the reader tells the scanner which grammar
roles may come next.
"""

import math
import re
from abc import ABC, abstractmethod
from functools import cached_property, lru_cache
from typing import NamedTuple

from .diagnostics import Source, Span, quote
from .expressions import NAME, Definitions, evaluate, number_text
from .suggestions import NUMBER
from .words import CHOICES, MARKS, ROLES, STATEMENT_OF, WORDS_BY_SPELLING, canonical_spelling, normalise

#: Matches the next token of the text, after white space. The most frequent kind of token comes first.
PIECE = re.compile(
    rf'\s*(?:(?P<number>{NUMBER})(?![^\s()#":=])|(?P<mark>[()]|[*+-](?!(?i:[\d.]|inf|nan)))'
    r'|(?P<word>[^\s()#":={$][^\s()#":=]*)|(?P<equals>[:=])|(?P<comment>\#[^\n]*)'
    r'|(?P<expression>\{[^{}\n]*\}?)|(?P<name>\$[^\s()#":=]*)|(?P<string>"[^"\n]*"?))'
)
#: The roles of the tokens after which a ``=`` or ``:`` may stand.
BEFORE_EQUALS = {*ROLES, "VARIABLE"} - {"BOOL", "NULL"}
PARENTHESIS = re.compile(r"[()]")
#: The roles of the tokens that a ``$name`` may stand for: values, and no keyword of a statement.
VALUES = frozenset(
    ("NUMBER", "WORD", "FILE", "TEXTURE_NAME", "BOOL", "NULL", "MATERIAL_KIND", "CONDUCTOR", "DIELECTRIC", "KIND")
).union(CHOICES)

#: The roles of the placeholder for a ``$name`` without a value; the first role that the grammar expects is used.
PLACEHOLDERS = ("NUMBER", "WORD", *sorted(VALUES))


class Token(NamedTuple):
    """A token, which is the piece of the text from the offset ``start`` to the offset ``end``.

    ``role`` is the grammar role of the token. The role of a comment is COMMENT, and the role of a misplaced ``=`` or
    ``:`` is EQUALS. A token with the empty role ``""`` stands for the end of the text. ``text`` is the content of the
    token: for a ``$name`` or an expression its value, and for a string the text without its quotes.
    """

    role: str
    text: str
    start: int
    end: int

    @property
    def span(self) -> Span:
        """The text offsets at which the token starts and ends."""
        return Span(self.start, self.end)


#: The value of "the previous token" before the first token is read.
START = Token("", "", 0, 0)


class Scanner(ABC):
    """Reads the tokens of a scene's text, in order.

    ``tokens`` lists the tokens that were read, including comments; ``last`` is the last token that is not a comment.
    ``token`` is the current token, and ``previous_end`` is the text offset at the end of the token before the current
    token. ``expected`` is the set of grammar roles that the current token may have. ``keyword`` is the first token of
    the current statement. A ``$name`` without a value is replaced by a placeholder: a token with a role that the
    grammar expects.
    """

    def __init__(self, source: Source, definitions: Definitions) -> None:
        self.source, self.definitions = source, definitions
        self.tokens: list[Token] = []
        self.position = self.previous_end = 0
        self.last = self.token = self.keyword = START
        self.expected = frozenset[str]()

    def read_token(self, expected: frozenset[str]) -> Token:
        """Reads and returns the next token that is not a comment; at the end of the text, the token has the empty role
        ``""``. A mark ``=`` or ``:`` after a keyword is skipped.

        ``expected`` are the grammar roles that the token may have. The method :meth:`with_expected_role` may change a
        token with another role. Raises SceneError if no expected role fits the token, if a quote, a comment or a brace
        is not closed, and for a wrong expression or a wrong ``$name``.
        """
        self.expected, self.previous_end = expected, self.last.end
        text = self.source.text
        while found := PIECE.match(text, self.position):
            kind = found.lastgroup or ""
            start, self.position = found.span(kind)
            piece = text[start : self.position]
            if kind == "number":
                role = "NUMBER"
            elif kind == "word":
                role = role_of(piece, expected, self.keyword.role)
            elif kind == "equals" and self.last.role in BEFORE_EQUALS:
                continue
            elif kind == "comment" or (piece == "(" and "LPAR" not in expected):
                self.read_comment(kind, start)
                continue
            elif kind == "mark" and (piece != ")" or "RPAR" in expected):
                role = MARKS[piece]
            else:
                role, piece = self.rare_token(kind, piece, Span(start, self.position))
            token = tuple.__new__(Token, (role, piece, start, self.position))  # twice as fast as Token(...)
            self.tokens.append(token)
            self.last = token
            break
        else:
            token = Token("", "", len(text), len(text))
        self.token = token if token.role in expected else self.with_expected_role(token)
        return self.token

    @abstractmethod
    def with_expected_role(self, token: Token) -> Token:
        """Returns the token with a role that the grammar expects here; raises SceneError if none fits."""

    @cached_property
    def closings(self) -> dict[int, int]:
        """A dictionary from the offset of each ``(`` that is closed to the offset after the matching ``)``."""
        open_starts: list[int] = []
        closings: dict[int, int] = {}
        for parenthesis in PARENTHESIS.finditer(self.source.text):
            if parenthesis[0] == "(":
                open_starts.append(parenthesis.start())
            elif open_starts:
                closings[open_starts.pop()] = parenthesis.end()
        return closings

    def read_comment(self, kind: str, start: int) -> None:
        """Reads a comment: with ``#`` or a parenthesis ("mark"), which must be closed (SceneError)."""
        if kind == "mark":
            if start not in self.closings:
                raise self.source.error(Span(start, start + 1), "this comment is not closed; expected ')'", "unclosed")
            self.position = self.closings[start]
        self.tokens.append(Token("COMMENT", self.source.text[start : self.position], start, self.position))

    def rare_token(self, kind: str, piece: str, span: Span) -> tuple[str, str]:
        """Returns the role and the text of the token of a ``piece`` that matched the less frequent group ``kind`` of
        :data:`PIECE`; the text of an expression is its value, or 1 if it has none. Raises SceneError as
        :meth:`read_token`.
        """
        if kind == "mark":
            raise self.source.error(span, "found ')' without its '('; expected it after a '('", "unclosed")
        if kind == "equals":
            return "EQUALS", piece
        if kind == "string":
            if len(piece) < 2 or piece[-1] != '"':
                raise self.source.error(span, "this quote is not closed on its line; expected '\"'", "unclosed")
            return "STRING", piece[1:-1]
        if kind == "expression":
            value = evaluate(self.source, span, self.definitions)
            return "NUMBER", "1" if math.isnan(value) else number_text(value)
        return self.name_token(piece, span)

    def name_token(self, name: str, span: Span) -> tuple[str, str]:
        """Returns the role and the text of the token of a ``$name``: after DEFAULT the role VARIABLE, elsewhere those
        of the name's value. A value that is not a single word or number is a STRING.

        A name without a value is replaced by a placeholder with a role that the grammar expects. Raises SceneError for
        a wrong name, and for a value that would be a keyword of the language at this place.
        """
        if not NAME.fullmatch(name, 1):
            reason = f"found {quote(name)}; expected letters, digits and _ after $, and arithmetic as in {{$x - 1}}"
            raise self.source.error(span, reason, "name")
        if "VARIABLE" in self.expected:
            return "VARIABLE", name
        text = self.definitions.value_text(name[1:], span)
        if text is None:
            role = next((role for role in PLACEHOLDERS if role in self.expected), "WORD")
            return role, canonical_spelling(role) if role in ROLES else "1" if role == "NUMBER" else name
        piece = PIECE.fullmatch(text)  # a value that is not a single word or number is read as a string
        if piece is None or piece.lastgroup not in ("word", "number") or piece.start(piece.lastgroup) > 0:
            return "STRING", text
        role = "NUMBER" if piece.lastgroup == "number" else role_of(text, self.expected, self.keyword.role)
        if role not in VALUES:
            raise self.source.error(span, "found a keyword; expected a number, or a word that is a value", "name")
        return role, text


@lru_cache(maxsize=1 << 12)
def role_of(text: str, expected: frozenset[str], statement: str) -> str:
    """Returns the grammar role of a word: the role of an expected keyword if the word is one, otherwise the role of a
    name (TEXTURE_NAME, FILE or WORD) that the grammar expects. A word that fits nowhere gets the role of an unexpected
    keyword if it is one, or else TEXTURE_NAME or WORD.

    ``expected`` are the roles that the grammar allows at the word's place. If a word can either continue the current
    ``statement`` or begin the next statement, it gets the role that continues the current statement.
    """
    spelling = normalise(text)
    roles = [word.role for word in WORDS_BY_SPELLING.get(spelling, ())]
    if fitting := [role for role in roles if role in expected]:
        return next((role for role in fitting if STATEMENT_OF.get(role) == statement), fitting[0])
    if spelling.startswith("t-") and ("TEXTURE_NAME" in expected or "WORD" not in expected):
        return "TEXTURE_NAME"
    if "FILE" in expected and "." in text and any(c.isalpha() for c in text):
        return "FILE"
    return roles[0] if roles and "WORD" not in expected else "WORD"
