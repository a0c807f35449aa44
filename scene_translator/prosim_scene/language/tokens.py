"""Splits a text into tokens.

Keywords depend on the context, so the reader passes the roles that it expects next.
"""

import math
import re
from abc import ABC, abstractmethod
from contextlib import suppress
from functools import lru_cache
from typing import NamedTuple

from .diagnostics import SceneError, Source, Span, quote
from .expressions import NAME, Definitions, evaluate, number_text
from .suggestions import NUMBER
from .words import MARKS, ROLES, STATEMENT_OF, WORDS_BY_SPELLING, canonical_spelling, normalise

#: The next piece of the text, after white space. The most frequent kind comes first.
PIECE = re.compile(
    rf'\s*(?:(?P<number>{NUMBER})(?![^\s()#":=])|(?P<mark>[()]|[*+-](?!(?i:[\d.]|inf|nan)))'
    r'|(?P<word>[^\s()#":={$][^\s()#":=]*)|(?P<equals>[:=])|(?P<comment>\#[^\n]*)'
    r'|(?P<expression>\{[^{}\n]*\}?)|(?P<name>\$[^\s()#":=]*)|(?P<string>"[^"\n]*"?))'
)
#: The next plain numbers, up to as many as a word has; none of them is a part of a word.
NUMBERS = re.compile(rf'\s*({NUMBER}(?:\s+{NUMBER}){{0,3}})(?![^\s()#":=])')
EQUALS = re.compile(r"\s*[:=]")
PARENTHESIS = re.compile(r"[()]")
#: The roles of tokens that a name may represent: values, which begin no statement.
VALUES = frozenset(
    ("NUMBER", "WORD", "FILE", "TEXTURE_NAME", "BOOL", "NULL", "MATERIAL_KIND", "CONDUCTOR", "DIELECTRIC", "KIND")
)


class Token(NamedTuple):
    """A piece of the text from ``start`` to ``end``.

    ``role``: its role in the grammar, COMMENT, REST (the text after END), EQUALS (a misplaced mark), or ``""`` at the
    end of the text. ``text``: its content: the value of a name or an expression, a string without its quotes. Plain
    numbers may be one token, NUMBERS.
    """

    role: str
    text: str
    start: int
    end: int

    @property
    def span(self) -> Span:
        """The span of the token in the text."""
        return Span(self.start, self.end)

    def separated(self) -> list["Token"]:
        """This token, or those of its NUMBERS."""
        if self.role != "NUMBERS":
            return [self]
        found = ((number[0], *number.span()) for number in re.finditer(r"\S+", self.text))
        return [Token("NUMBER", text, self.start + start, self.start + end) for text, start, end in found]


#: The token before the first one.
START = Token("", "", 0, 0)


class Scanner(ABC):
    """Reads the tokens of a text, in order.

    ``pieces`` are all tokens so far, with comments; ``last`` is the last one that is not a comment. ``token`` is the
    present one, ``expected`` the roles that were expected there, and ``keyword`` that of the statement around it. A
    name without a value is read as any value that fits.
    """

    def __init__(self, source: Source, definitions: Definitions) -> None:
        self.source, self.definitions = source, definitions
        self.pieces: list[Token] = []
        self.position = 0
        self.last = self.token = self.keyword = START
        self.expected = frozenset[str]()

    @property
    def tokens(self) -> list[Token]:
        """All tokens so far, with comments, and with a token for each number."""
        return [token for piece in self.pieces for token in piece.separated()]

    def read_token(self, expected: frozenset[str]) -> Token:
        """Reads the next token that is not a comment.

        Raises SceneError if its role is not one of the ``expected`` ones, for unclosed marks and for wrong expressions.
        """
        text, match, self.expected = self.source.text, PIECE.match, expected
        while found := match(text, self.position):
            kind, group = found.lastgroup or "", found.lastindex or 0
            start, self.position = found.span(group)
            piece = found[group]
            if kind == "word":
                token = Token(role_of(piece, expected, self.keyword.role), piece, start, self.position)
            elif kind == "equals" and (self.last.role in ROLES or self.last.role == "VARIABLE"):
                continue
            elif kind == "comment" or (piece == "(" and "LPAR" not in expected):
                self.read_comment(kind, start)
                continue
            elif kind == "mark" and (piece != ")" or "RPAR" in expected):
                token = Token(MARKS[piece], piece, start, self.position)
            else:
                token = self.rare_token(kind, piece, Span(start, self.position))
            self.pieces.append(token)
            self.last = token
            break
        else:
            token = Token("", "", len(text), len(text))
        self.token = token if token.role in expected else self.expected_token(token)
        return self.token

    @abstractmethod
    def expected_token(self, token: Token) -> Token:
        """The token with an expected role in place of its own; raises SceneError if none fits."""

    def read_plain_numbers(self) -> list[Token]:
        """Reads the plain numbers that follow as one token, in a list, or an empty list; names may follow."""
        text = self.source.text
        if self.last.role in ROLES and (mark := EQUALS.match(text, self.position)):
            self.position = mark.end()
        if (found := NUMBERS.match(text, self.position)) is None:
            return []
        start, self.position = found.span(1)
        self.last = Token("NUMBERS", found[1], start, self.position)
        self.pieces.append(self.last)
        return [self.last]

    def read_comment(self, kind: str, start: int) -> None:
        """Reads the comment that begins at ``start``; parentheses may be nested."""
        if kind == "mark":
            depth = 0
            for found in PARENTHESIS.finditer(self.source.text, start):
                depth += 1 if found[0] == "(" else -1
                if depth == 0:
                    self.position = found.end()
                    break
            else:
                reason = "this comment is not closed; expected ')'"
                raise self.source.error(Span(start, start + 1), reason, "unclosed")
        self.pieces.append(Token("COMMENT", self.source.text[start : self.position], start, self.position))

    def rare_token(self, kind: str, piece: str, span: Span) -> Token:
        """The token of a less frequent kind; ``kind``: the group of :data:`PIECE` that matched."""
        if kind == "number":
            return Token("NUMBER", piece, *span)
        if kind == "mark":
            raise self.source.error(span, "found ')' without its '('; expected it after a '('", "unclosed")
        if kind == "equals":
            return Token("EQUALS", piece, *span)
        if kind == "string":
            if len(piece) < 2 or piece[-1] != '"':
                raise self.source.error(span, "this quote is not closed on its line; expected '\"'", "unclosed")
            return Token("STRING", piece[1:-1], *span)
        if kind == "expression":
            value = evaluate(self.source, span, self.definitions)
            return Token("NUMBER", "1" if math.isnan(value) else number_text(value), *span)
        return self.name_token(piece, span)

    def name_token(self, name: str, span: Span) -> Token:
        """The token of a ``$name``: a VARIABLE after DEFAULT, elsewhere the token of its value. A name without a value
        gets a placeholder that fits the grammar.
        """
        if not NAME.fullmatch(name, 1):
            reason = "expected letters, digits and _ after $, and arithmetic in braces: {$x - 1}"
            raise self.source.error(span, f"found {quote(name)}; {reason}", "name")
        expected = self.expected
        if "VARIABLE" in expected:
            return Token("VARIABLE", name, *span)
        text = self.definitions.value_text(name[1:], span)
        if text is None:
            role = next((role for role in ("NUMBER", "WORD", *sorted(VALUES)) if role in expected), "WORD")
            return Token(role, canonical_spelling(role) if role in ROLES else "1" if role == "NUMBER" else name, *span)
        piece = PIECE.fullmatch(text)
        if piece is None or piece.lastgroup not in ("word", "number") or piece.start(piece.lastgroup) > 0:
            return Token("STRING", text, *span)
        role = "NUMBER" if piece.lastgroup == "number" else role_of(text, expected, self.keyword.role)
        if role not in VALUES:
            value = self.source.names.get(name[1:], quote(text))
            reason = f"{name} stands for {value}, a keyword; expected a number, or a word that is a value"
            raise self.source.error(span, reason, "name")
        return Token(role, text, *span)

    def read_rest(self) -> Token | None:
        """Reads the comments after END, and any other text there as one token REST, which it returns."""
        text = self.source.text
        while found := PIECE.match(text, self.position):
            kind = str(found.lastgroup)
            start, self.position = found.span(kind)
            if kind == "comment" or found[kind] == "(":
                with suppress(SceneError):  # an unclosed parenthesis
                    self.read_comment(kind, start)
                    continue
            self.pieces.append(Token("REST", text[start:], start, len(text)))
            return Token("REST", found[kind], start, self.position)
        return None


@lru_cache(maxsize=1 << 12)
def role_of(text: str, expected: frozenset[str], statement: str) -> str:
    """The role of a word: that of the keyword that fits here, of a name, or else the most likely one.

    A word may have a role in the present statement and one as the next statement; the present one has priority.
    """
    spelling = normalise(text)
    roles = [word.role for word in WORDS_BY_SPELLING.get(spelling, ())]
    if fitting := [role for role in roles if role in expected]:
        return next((role for role in fitting if STATEMENT_OF.get(role) == statement), fitting[0])
    if spelling.startswith("t-") and ("TEXTURE_NAME" in expected or "WORD" not in expected):
        return "TEXTURE_NAME"
    if "FILE" in expected and "." in text and any(c.isalpha() for c in text):
        return "FILE"
    if "WORD" in expected:
        return "WORD"
    return roles[0] if roles else "WORD"
