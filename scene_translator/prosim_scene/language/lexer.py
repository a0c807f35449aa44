"""Text -> tokens and remarks.

The lexer is our own, because of the language's rule for parentheses (an argument directly after SCALE, TRANSLATE and
ROTATE, a remark elsewhere) and because a word is a keyword only where the grammar has a place for that keyword.
"""

import re
from collections.abc import Callable, Iterator
from functools import lru_cache

from lark import Token

from . import expressions, foreign
from .definitions import NAME, NUMBER, Definitions, UndefinedError, written
from .messages import Place, SceneError, Source, quote
from .words import OPERATORS, ROLES, ROWS, STATEMENT_OF, STATEMENTS, fold

#: The piece that stands at a place, or behind the space that is there. What is most frequent comes first.
PIECE = re.compile(
    rf'\s*(?:(?P<number>{NUMBER.pattern})(?![^\s()#":=])|(?P<operator>[*+-](?![\d.]|inf|nan))'
    r'|(?P<word>[^\s()#":={][^\s()#":=]*)|(?P<equals>[:=])|(?P<open>\()|(?P<close>\))'
    r'|(?P<remark>\#[^\n]*)|(?P<expression>\{[^{}\n]*\}?)|(?P<string>"[^"\n]*"?))',
    re.IGNORECASE,
)
PARENTHESIS = re.compile(r"[()]")
#: What a name may stand for: a word that begins nothing.
VALUES = frozenset(
    ("NUMBER", "WORD", "FILE", "TEXTURE_NAME", "BOOL", "NULL", "MATERIAL_KIND", "CONDUCTOR", "DIELECTRIC", "KIND")
)


def lex(
    source: Source, accepted: Callable[[], frozenset[str]], definitions: Definitions, start: int = 0
) -> Iterator[Token]:
    """Tokens and remarks of a text in order, from ``start``, where a statement begins, up to END and what follows it.

    Tokens have the terminals of the grammar as types, remarks have REMARK, a colon or an equals sign that follows no
    keyword has EQUALS, and what else follows END is one REST.
    ``accepted()`` says which terminals have a place where the parser stands: each token has to be given to it before
    the next one is asked for. Names, and what stands in braces, are tokens of what they come to by ``definitions``,
    which learn from DEFAULT statements. Raises SceneError for marks that are not closed and the like.
    """
    return _Lexer(source, accepted, definitions, start).tokens()


class _Lexer:
    """A text, and how far it has been read."""

    def __init__(
        self, source: Source, accepted: Callable[[], frozenset[str]], definitions: Definitions, start: int
    ) -> None:
        self.source, self.accepted, self.definitions = source, accepted, definitions
        self.position = start
        self.previous: Token | None = None
        self.statement = ""  # the role of the last word that began one
        self.open_argument: Token | None = None  # the parenthesis of SCALE, ROTATE or TRANSLATE

    def tokens(self) -> Iterator[Token]:
        """What :func:`lex` gives."""
        text, match = self.source.text, PIECE.match
        while found := match(text, self.position):
            kind = str(found.lastgroup)
            start, self.position = found.span(kind)
            if kind == "number":
                token: Token | None = _token("NUMBER", found[kind], start)
            elif kind == "word" and text[start] != "$":
                token = self.word(found[kind], start)
            else:
                token = self.other(kind, found[kind], start)
            if token is None:
                continue
            ends = token.type == "END" and "END" in self.accepted()
            yield token
            if token.type != "REMARK":
                if self.previous is not None and self.previous.type == "VARIABLE":
                    self.definitions.default(self.previous[1:], str(token))
                self.previous = token
            if ends:
                break
        if self.open_argument:
            raise self.source.error(place(self.open_argument), "this '(' is not closed")
        if self.previous is not None and self.previous.type == "END":
            yield from _after_end(self.source, self.position)

    def other(self, kind: str, piece: str, start: int) -> Token | None:
        """The token or remark of what is neither a word nor a number; None for what only separates words."""
        if kind == "open":
            return self.parenthesis(start)
        if kind == "remark":
            if said := foreign.remark(piece):
                self.source.doubt(Place(start, self.position), said)
            return _token("REMARK", piece, start)
        if kind == "close":
            if not self.open_argument:
                raise self.source.error(Place(start, self.position), "found ')' without its '('")
            self.open_argument = None
            return _token("RPAR", piece, start)
        if kind == "equals":
            follows = self.previous is not None and self.previous.type in (*ROLES, "VARIABLE")
            return None if follows else _token("EQUALS", piece, start)  # which has no place in the grammar
        if kind == "string":
            if len(piece) < 2 or piece[-1] != '"':
                raise self.source.error(Place(start, self.position), "this quote is not closed on its line")
            return _token("STRING", piece[1:-1], start, self.position)
        if kind == "expression":
            return self.expression(start)
        return _token(OPERATORS[piece], piece, start) if kind == "operator" else self.name(piece, start)

    def parenthesis(self, start: int) -> Token:
        """An argument directly after SCALE, ROTATE or TRANSLATE, a remark elsewhere."""
        if "LPAR" in self.accepted():
            self.open_argument = _token("LPAR", "(", start)
            return self.open_argument
        self.position = _end_of_remark(self.source, start)
        return _token("REMARK", self.source.text[start : self.position], start)

    def expression(self, start: int) -> Token:
        """What stands in braces, as the number that it comes to."""
        braces = Place(start, self.position)
        try:
            text = written(expressions.evaluate(self.source, braces, self.definitions.number))
        except UndefinedError:
            if not self.definitions.tolerant:
                raise
            text = "1"
        return _token("NUMBER", text, start, self.position)

    def name(self, word: str, start: int) -> Token:
        """A name: itself after DEFAULT, and elsewhere the number or the word that it stands for."""
        where = Place(start, self.position)
        if not NAME.fullmatch(word, 1):
            raise self.source.error(
                where,
                f"found {quote(word)}; expected letters, digits and _ after $, and arithmetic in braces: {{$x - 1}}",
            )
        accepted = self.accepted()
        if "VARIABLE" in accepted:
            return _token("VARIABLE", word, start)
        try:
            text = self.definitions.text(word[1:], where)
        except UndefinedError:
            if not self.definitions.tolerant:
                raise
            kind = next((role for role in ("NUMBER", "WORD", *sorted(VALUES)) if role in accepted), "WORD")
            return _token(kind, word, start)
        piece = PIECE.fullmatch(text)
        if piece is None or piece.lastgroup not in ("word", "number") or piece.start(piece.lastgroup) > 0:
            return _token("STRING", text, start, self.position)
        kind = terminal(text, accepted, self.statement)
        if kind not in VALUES:
            raise self.source.error(
                where,
                f"{word} stands for {self.source.names.get(word[1:], quote(text))}, a keyword; expected a number, or a "
                "word that is a value",
            )
        return _token(kind, text, start, self.position)

    def word(self, word: str, start: int) -> Token:
        """A word by what fits where it stands."""
        token = _token(terminal(word, self.accepted(), self.statement), word, start)
        if token.type in STATEMENTS:
            self.statement = token.type
        return token


def place(token: Token) -> Place:
    """Where a token stands."""
    assert token.start_pos is not None and token.end_pos is not None
    return Place(token.start_pos, token.end_pos)


def _token(kind: str, value: str, start: int, end: int | None = None) -> Token:
    token = str.__new__(Token, value)  # what Token(...) does, in a third of its time
    token.type, token.value = kind, value
    token.start_pos, token.end_pos = start, start + len(value) if end is None else end
    token.line = token.column = token.end_line = token.end_column = None
    return token


def _end_of_remark(source: Source, start: int) -> int:
    depth = 0
    for match in PARENTHESIS.finditer(source.text, start):
        depth += 1 if match[0] == "(" else -1
        if depth == 0:
            return match.end()
    raise source.error(Place(start, start + 1), "this remark is not closed; expected ')'")


def _after_end(source: Source, position: int) -> Iterator[Token]:
    """The remarks after END; from anything else on, the rest of the text."""
    text = source.text
    while found := PIECE.match(text, position):
        kind = str(found.lastgroup)
        start, position = found.span(kind)
        stop: int | None = position
        if kind == "open":
            try:
                stop = _end_of_remark(source, start)
            except SceneError:
                stop = None
        elif kind != "remark":
            stop = None
        if stop is None:
            source.doubt(Place(start, position), "what follows END is ignored")
            yield _token("REST", text[start:], start)
            return
        yield _token("REMARK", text[start:stop], start)
        position = stop


@lru_cache(maxsize=1 << 12)
def terminal(word: str, accepted: frozenset[str], statement: str) -> str:
    """The terminal of a word: a number, the keyword that fits here, a name, or else whatever explains it best.

    The parser's table may accept, at the end of a list of numbers, what has its place in another statement: a word of
    the present one goes before.
    """
    if NUMBER.fullmatch(word):
        return "NUMBER"
    folded = fold(word)
    roles = [row.role for row in ROWS.get(folded, ())]
    fitting = [role for role in roles if role in accepted]
    if fitting:
        return next((role for role in fitting if STATEMENT_OF.get(role) == statement), fitting[0])
    if folded.startswith("t-") and "TEXTURE_NAME" in accepted:
        return "TEXTURE_NAME"
    if "FILE" in accepted and "." in word and any(c.isalpha() for c in word):
        return "FILE"
    if "WORD" in accepted:
        return "WORD"
    return roles[0] if roles else "WORD"
