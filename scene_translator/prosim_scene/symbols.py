"""What an editor asks about a text: its symbols (indices, textures, names), what fits at a place, what a word means."""

import re
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from . import descriptions
from .language import words
from .language.analysis import analyse
from .language.expressions import CONSTANTS, FUNCTIONS
from .language.reader import Reader
from .language.tokens import FRAME, NAME, TIME, Token
from .language.words import ROLES, STATEMENTS, Numbers, row

#: The keywords that an index follows.
INDEXED = ("SURFACE", "TRANSFORM", "PRIMITIVE", "USE")
VARIABLE = re.compile(r"\$([A-Za-z_]\w*)", re.ASCII)
#: The word before the cursor, and the arithmetic that the cursor is in.
WORD = re.compile(r'[^\s()#":=]*\Z')
BRACES = re.compile(r"\{[^{}\n]*\Z")
IN_BRACES = re.compile(r"[$\w]*\Z")


@dataclass(frozen=True)
class Symbol:
    """What has a name of its own: the ``kind`` is "index", "texture", "solid" or "name"."""

    kind: str
    key: str


@dataclass(frozen=True)
class Occurrence:
    """A place, offsets ``start`` to ``end``, where a symbol is used, or defined; ``after``: the keyword before it."""

    symbol: Symbol
    start: int
    end: int
    defines: bool
    after: str


@dataclass(frozen=True)
class Completion:
    """A word for the place of the text from ``start`` on; ``detail``: what follows it. The lowest ``rank`` is first."""

    label: str
    kind: str  # "statement", "keyword", "metal", "glass", "texture", "solid", "index", "name" or "function"
    start: int
    detail: str = ""
    documentation: str = ""
    rank: int = 0


class Symbols:
    """A text, read, and the table of its symbols."""

    def __init__(self, text: str, path: Path | str | None = None) -> None:
        self.text = text
        self.reader, self.diagnostics, self.document = analyse(text, str(path or "<string>"))

    @cached_property
    def tokens(self) -> list[Token]:
        """All tokens but comments."""
        return [token for token in self.reader.tokens if token.role not in ("COMMENT", "REST")]

    @cached_property
    def table(self) -> dict[Symbol, list[Occurrence]]:
        """Where each symbol stands, in order."""
        result: dict[Symbol, list[Occurrence]] = {}
        before = ""
        for token in self.tokens:
            for one in self._occurrences(token, before):
                result.setdefault(one.symbol, []).append(one)
            before = token.role
        return result

    def _occurrences(self, token: Token, before: str) -> Iterator[Occurrence]:
        """The symbols in a token; ``before``: the role of the one before it."""
        if self.text[token.start] in "${":
            for found in VARIABLE.finditer(self.text, token.start, token.end):
                yield Occurrence(Symbol("name", found[1]), *found.span(), token.role == "VARIABLE", before)
        elif token.role == "NUMBER" and before in INDEXED and re.fullmatch("[0-9]{1,9}", token.text):
            symbol = Symbol("index", str(int(token.text)))
            yield Occurrence(symbol, token.start, token.end, before in STATEMENTS, before)
        elif token.role == "TEXTURE_NAME":
            symbol = Symbol("texture", words.texture_name(token.text))
            yield Occurrence(symbol, token.start, token.end, before == "TEXTURE", before)
        elif token.role == "USE" or before == "SOLID":
            symbol = Symbol("solid", words.normalise(token.text))
            yield Occurrence(symbol, token.start, token.end, before == "SOLID", before)

    def occurrences(self, symbol: Symbol) -> list[Occurrence]:
        """Where a symbol is used or defined."""
        return self.table.get(symbol, [])

    def at(self, offset: int) -> Occurrence | None:
        """The symbol at an offset, or that ends there."""
        everywhere = (one for found in self.table.values() for one in found)
        return min((o for o in everywhere if o.start <= offset <= o.end), key=lambda o: o.start, default=None)

    def renamed(self, symbol: Symbol, new: str) -> list[Occurrence]:
        """The places where ``new`` has to be written for a symbol to have that name.

        Raises ValueError where that cannot be a name, or is another's.
        """
        new = new.removeprefix("$") if symbol.kind == "name" else new
        if symbol.kind == "index":
            if not re.fullmatch("[0-9]{1,9}", new):
                raise ValueError(f"{new!r} is no index; expected {words.numbers('SURFACE', 'surfaces').bounds()}")
            new = str(int(new))
        elif symbol.kind == "texture":
            new = words.normalise(new)
            if not re.fullmatch(r't-[^\s()#":={}]+', new):
                raise ValueError(f"{new!r} is no name of a texture; expected t- and a word")
        elif symbol.kind == "solid":
            new = words.normalise(new)
            if not re.fullmatch(r"[^\W\d][\w-]*", new) or new in words.ROWS:
                raise ValueError(f"{new!r} is no name of a solid; expected a word that the language does not have")
        elif not NAME.fullmatch(new):
            raise ValueError(f"{new!r} cannot be a name; expected letters, digits and _")
        elif symbol.key in (FRAME, TIME):
            raise ValueError(f"${symbol.key} is the language's own name; expected another one to be renamed")
        if Symbol(symbol.kind, new) != symbol and Symbol(symbol.kind, new) in self.table:
            raise ValueError(f"{new!r} is there already; expected a new one")
        return self.occurrences(symbol)

    # ---- What a word means

    def hover(self, offset: int) -> tuple[int, int, str] | None:
        """``(start, end, Markdown)`` of what is said of the word at an offset."""
        if here := self.at(offset):
            return here.start, here.end, self._of_symbol(here.symbol)
        i = bisect_right(self.tokens, offset, key=lambda token: token.start) - 1
        token, before = self.tokens[max(i, 0)] if self.tokens else None, self.tokens[i - 1].role if i > 0 else ""
        if token is None or not token.start <= offset < token.end:
            return None
        text, name = "", words.normalise(token.text)
        if token.role in ROLES:
            text = descriptions.of_word(row(token.role, token.text))
        elif token.role in descriptions.OPERATORS:
            text = descriptions.OPERATORS[token.role]
        elif token.role == "WORD" and before in ("METAL", "CONDUCTOR"):
            text = descriptions.of_metal(name) if name in words.METALS else "a metal that nobody knows"
        elif token.role == "WORD" and before == "DIELECTRIC" and name in words.GLASSES:
            text = f"The glass {words.GLASSES[name]}: n-refr = {words.INDICES[words.GLASSES[name]]} at 587.6 nm"
        return (token.start, token.end, text) if text else None

    @property
    def _names(self) -> dict[str, str]:
        """The values of names."""
        defaults: dict[str, str] = self.reader.fields["defaults"]
        return {FRAME: "0", TIME: f"${FRAME} / 24"} | defaults

    @property
    def _textures(self) -> dict[str, str]:
        """The kinds of textures."""
        patterns = self.reader.fields["patterns"].items()
        return words.BUILT_IN | {name: pattern.kind for name, pattern in patterns if pattern}

    def _of_symbol(self, symbol: Symbol) -> str:
        """What is said of an index, a texture or a name."""
        if symbol.kind == "name":
            value = self._names.get(symbol.key)
            return f"**${symbol.key}**" + (f" = {value}" if value else ": nothing here says what it stands for")
        if symbol.kind == "texture":
            kind = self._textures.get(symbol.key)
            return f"**{symbol.key}** " + (descriptions.TEXTURES[kind] if kind else "no TEXTURE has this name")
        starts = [token.start for token in self.tokens if token.role in STATEMENTS]
        ends = [*starts[1:], len(self.text)]
        defining = [bisect_right(starts, one.start) - 1 for one in self.occurrences(symbol) if one.defines]
        parts = "\n".join(self.text[starts[i] : ends[i]].strip() for i in defining)
        return f"```scn\n{parts}\n```" if parts else f"no SURFACE or TRANSFORM has the index {symbol.key}"

    # ---- What fits

    def completions(self, offset: int) -> list[Completion]:
        """The words that fit at an offset, whatever has been typed of one already."""
        line = self.text[self.text.rfind("\n", 0, offset) + 1 : offset]
        if braces := BRACES.search(line):
            start = offset - len((IN_BRACES.search(braces[0]) or braces)[0])
            functions = [Completion(name, "function", start, rank=2) for name in (*FUNCTIONS, *CONSTANTS)]
            return [*self._variables(start), *functions]
        start = offset - len((WORD.search(line) or [""])[0])
        before = Reader(self.text[:start], tolerant=True)
        last, expected = before.scanner.last, before.expected
        errors = [one.error.code for one in before.skipped if one.end == start]
        unclosed = "unclosed" in errors and "RPAR" not in expected
        comment = before.tokens and before.tokens[-1].text.startswith("#") and before.tokens[-1].end == start
        if unclosed or comment or last.role == "END":
            return []
        if last.role in INDEXED:
            return [*self._indices(last.role, start), *self._variables(start)]
        if last.role in ROLES and isinstance(row(last.role, last.text).takes, Numbers):
            return self._variables(start)
        result = [one for role in words.ORDER if role in ROLES and role in expected for one in _words(role, start)]
        if last.role in ("METAL", "CONDUCTOR"):
            result += [
                Completion(name, "metal", start, words.METALS[name], descriptions.of_metal(name))
                for name in words.METALS
            ]
        if last.role == "DIELECTRIC":
            result += [Completion(name, "glass", start) for name in words.GLASSES]
        if "TEXTURE_NAME" in expected:
            kinds = self._textures.items()
            result += [Completion(name, "texture", start, kind, descriptions.TEXTURES[kind]) for name, kind in kinds]
        if "USE" in expected:
            result += [Completion(name, "solid", start) for name in before.fields["solids"]]
        if {"NUMBER", "WORD"} & expected:
            result += self._variables(start)
        return result

    def _variables(self, start: int) -> list[Completion]:
        return [Completion(f"${name}", "name", start, value, rank=1) for name, value in self._names.items()]

    def _indices(self, role: str, start: int) -> list[Completion]:
        """Indices that lack this statement; or for a primitive, those that have one."""
        given: dict[str, set[int]] = {keyword: set() for keyword in INDEXED}
        for symbol, found in self.table.items():
            for one in found if symbol.kind == "index" else ():
                given[one.after].add(int(symbol.key))
        used, defined = given["PRIMITIVE"] | given["USE"], given["SURFACE"] | given["TRANSFORM"]
        fitting = defined if role in ("PRIMITIVE", "USE") else (used | defined) - given[role]
        fitting = fitting or {max(set().union(*given.values()), default=-1) + 1}
        return [Completion(str(i), "index", start) for i in sorted(fitting)]


def _words(role: str, start: int) -> Iterator[Completion]:
    """The keywords of a role: those of the statement before statements, canonical spellings before others."""
    kind, rank = ("statement", 2) if role in STATEMENTS else ("keyword", 0)
    for word in words.of_role(role):
        for i, spelling in enumerate(word.spellings):
            detail, text = descriptions.takes(word), descriptions.of_word(word)
            yield Completion(spelling, kind, start, detail, text, rank + (i > 0))
