"""A statement, read on its own.

The parser is in the same state before every statement. So what comes of a statement depends on its text alone, and on
what ``$names`` stand for; and an error in one does not hide the others.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from lark import Token, UnexpectedToken

from . import lexer, parentheses
from .automaton import Parser
from .builder import Builder
from .definitions import Definitions, UndefinedError
from .document import Path
from .messages import Place, Said, SceneError, Source, what_is_said
from .parser import syntax_error
from .words import STATEMENTS, WORDS

#: A line that begins with the keyword of a statement.
STATEMENT_LINE = re.compile(
    r"^[ \t]*(?:"
    + "|".join(
        sorted((re.escape(s) for w in WORDS if w.role in STATEMENTS for s in w.spellings), key=len, reverse=True)
    )
    + r")(?![\w.-])",
    re.IGNORECASE | re.MULTILINE,
)


NOTHING: Mapping[str, Any] = {}


@dataclass(eq=False, slots=True)
class Unit:
    """A statement, up to the next one, with all offsets as they were when it was read at ``base``.

    ``kind``: the role of the keyword that begins it, empty where there is none; ``opening``: how long its first piece
    is; ``path``: the way to what it says; ``fields``: that, by the names of a Scene's fields; ``said``: what is said of
    it; ``uses`` and ``defines``: names, and what they stand for.

    Nobody asks for the pieces and the places of most statements: what is known to be right has its ``text``, and
    ``details``, those two, when they have been asked for; a tree the places of its ``nodes``, of which warnings tell.
    """

    base: int
    end: int
    kind: str = ""
    opening: int = 1
    path: Path | None = None
    fields: Mapping[str, Any] = field(default_factory=lambda: NOTHING)
    said: Sequence[Said] = ()
    uses: Mapping[str, str | None] = field(default_factory=lambda: NOTHING)
    defines: Mapping[str, str] = field(default_factory=lambda: NOTHING)
    text: str | None = None
    nodes: Sequence[Place] = ()
    details: tuple[list[Token], dict[Path, Place]] | None = None

    @property
    def tokens(self) -> list[Token]:
        """Its pieces, remarks among them."""
        return self._looked_at()[0]

    @property
    def places(self) -> dict[Path, Place]:
        """The places of what it says."""
        return self._looked_at()[1]

    def place(self, path: Path) -> Place | None:
        """Where a value stands, if it is in this statement."""
        if self.text is not None and path == self.path:
            return Place(self.base, self.base + self.opening)  # the keyword
        if self.nodes and path[:-1] == self.path:
            number = int(path[-1])
            return self.nodes[number] if number < len(self.nodes) else None
        return self.places.get(path)

    @property
    def wrong(self) -> bool:
        """Whether there is an error in it."""
        return any(said.error for said in self.said)

    def _looked_at(self) -> tuple[list[Token], dict[Path, Place]]:
        """Its pieces and places."""
        if self.details is None:
            source = Source(self.text or "", "")
            unit = read(source, 0, Definitions(source))
            for token in unit.tokens:
                token.start_pos, token.end_pos = (token.start_pos or 0) + self.base, (token.end_pos or 0) + self.base
            places = {path: Place(start + self.base, end + self.base) for path, (start, end) in unit.places.items()}
            self.details = unit.tokens, places
        return self.details


def read(source: Source, start: int, definitions: Definitions, name: int | None = None) -> Unit:
    """The unit that begins at ``start``, word by word; ``name``: where the one before it begins, if that is NAME."""
    unit = Unit(start, len(source.text), details=([], {}))
    said: list[Said] = []
    unit.said = said
    following: Token | None = None
    parser, tokens = Parser(), unit.tokens
    definitions.uses = set()
    source.doubts = []
    try:
        for token in lexer.lex(source, parser.choices, definitions, start):
            if token.type in STATEMENTS and unit.kind and token.type in parser.choices():
                unit.end, following = token.start_pos or 0, token
                break
            tokens.append(token)
            if token.type in STATEMENTS and not unit.kind:
                unit.kind = token.type
            if token.type not in ("REMARK", "REST"):
                parser.feed_token(token)
        _build(source, unit, parser, following)
    except UnexpectedToken as error:
        # The next word of a name may be one that begins a statement.
        before = [] if name is None else read(source, name, Definitions(source)).tokens
        after = [error.token] if following is not None else []
        said.append(
            _fail(source, unit, syntax_error(source, error.token, parser.accepts(), [*before, *tokens, *after]))
        )
    except SceneError as error:
        said.append(_fail(source, unit, error))
    said += source.doubts
    unit.uses = {name: definitions.now(name) for name in definitions.uses}
    if tokens:
        unit.opening = (tokens[0].end_pos or 0) - start
    if unit.kind == "DEFAULT" and not unit.wrong:
        words = [token for token in tokens if token.type != "REMARK"]
        unit.defines = {str(words[1][1:]): str(words[2])}
    return unit


def _build(source: Source, unit: Unit, parser: Parser, following: Token | None) -> None:
    """What a statement says, that the parser has been given all of; ``following``: the keyword of the next one."""
    if not unit.kind:
        return  # nothing but remarks
    if unit.kind != "END":
        if following is None and "END" not in parser.accepts():
            parser.feed_eof()  # which fails
        start, end = (unit.end, unit.end) if following is None else lexer.place(following)
        parser.feed_token(Token("END", str(following), start, end_pos=end))
    tree = parser.feed_eof()
    parentheses.judge(source, unit.tokens, tree)
    builder = Builder(source)
    unit.fields = builder.fields
    try:
        builder.statements(tree)
    finally:  # it has its place, right or wrong
        unit.places.update(builder.places)
        unit.path = next(iter(builder.places), None)


def _fail(source: Source, unit: Unit, error: SceneError) -> Said:
    """What is said of an error; what follows is read from the next line on that begins a statement."""
    said = what_is_said(error, unit.base)
    if isinstance(error, UndefinedError):
        said = replace(said, undefined=error.name)
    if unit.end == len(source.text):
        after = STATEMENT_LINE.search(source.text, max(said.start + 1, unit.base + 1))
        unit.end = after.end() - len(after[0].lstrip()) if after else len(source.text)
        unit.tokens[:] = [token for token in unit.tokens if (token.end_pos or 0) <= unit.end]
    return said
