"""The symbols of a text for an editor (indices, textures, solids, names), completion, and meanings of words."""

import re
from bisect import bisect_right
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

from .language import words
from .language.analysis import analyse
from .language.diagnostics import USE
from .language.expressions import CONSTANTS, FRAME, FUNCTIONS, TIME
from .language.reader import Reader
from .language.tokens import Token
from .language.words import NAMED, NOTHING, ROLES, STATEMENTS, Flags, Word, row

#: The keywords that an index follows.
INDEXED = ("SURFACE", "TRANSFORM", "PRIMITIVE", "USE")
#: The word before the cursor, and the arithmetic around the cursor.
WORD = re.compile(r'[^\s()#":=]*\Z')
OPERATORS = {
    "PLUS": "`+` A B: the union of two solids.",
    "MINUS": "`-` A B: the difference of two solids.",
    "TIMES": "`*` A B: the intersection of two solids.",
}
BRACES = re.compile(r"\{[^{}\n]*?([$\w]*)\Z")


class Symbol(NamedTuple):
    """A named thing: the ``kind`` is "index", "texture", "solid" or "name"."""

    kind: str
    key: str


class Occurrence(NamedTuple):
    """A use or a definition of a symbol, from offset ``start`` to ``end``; ``after``: the role before it."""

    symbol: Symbol
    start: int
    end: int
    defines: bool
    after: str


class Completion(NamedTuple):
    """A word that fits at ``start``; ``detail``: its parameters. The lowest ``rank`` is first."""

    label: str
    kind: str  # of LSP's CompletionItemKind
    start: int
    detail: str = ""
    documentation: str = ""
    rank: int = 0


class Symbols:
    """A text, its diagnostics, and the table of its symbols."""

    def __init__(self, text: str, path: Path | str | None = None) -> None:
        self.text = text
        self.reader, self.diagnostics, self.document = analyse(text, str(path or "<string>"))

    @cached_property
    def tokens(self) -> list[Token]:
        """All tokens except comments."""
        return [token for token in self.reader.tokens if token.role not in ("COMMENT", "REST")]

    @cached_property
    def table(self) -> dict[Symbol, list[Occurrence]]:
        """The places of each symbol, in order."""
        result: dict[Symbol, list[Occurrence]] = {}
        before = ""
        for token in self.tokens:
            for one in self._occurrences(token, before):
                result.setdefault(one.symbol, []).append(one)
            before = token.role
        return result

    def _occurrences(self, token: Token, before: str) -> Iterator[Occurrence]:
        """The symbols in a token; ``before``: the role of the token before it."""
        if self.text[token.start] in "${":
            for found in USE.finditer(self.text, token.start, token.end):
                yield Occurrence(Symbol("name", found[1]), *found.span(), token.role == "VARIABLE", before)
        elif token.role == "NUMBER" and before in INDEXED and re.fullmatch("[0-9]{1,9}", token.text):
            yield Occurrence(Symbol("index", str(int(token.text))), *token.span, before in STATEMENTS, before)
        elif token.role == "TEXTURE_NAME":
            yield Occurrence(
                Symbol("texture", words.texture_name(token.text)), *token.span, before == "TEXTURE", before
            )
        elif token.role == "USE" or before == "SOLID":
            yield Occurrence(Symbol("solid", words.normalise(token.text)), *token.span, before == "SOLID", before)

    def occurrences(self, symbol: Symbol) -> list[Occurrence]:
        """The places where a symbol is used or defined."""
        return self.table.get(symbol, [])

    def at(self, offset: int) -> Occurrence | None:
        """The symbol at an offset, or one that ends there."""
        everywhere = (one for found in self.table.values() for one in found)
        return min((o for o in everywhere if o.start <= offset <= o.end), key=lambda o: o.start, default=None)

    def renamed(self, symbol: Symbol, new: str) -> str | None:
        """The text with a symbol renamed; None if the name is invalid, or another symbol's."""
        text = self.text
        for one in reversed(self.occurrences(symbol)):
            text = text[: one.start] + new + text[one.end :]
        other = Symbols(text)
        places = [list(map(len, symbols.table.values())) for symbols in (self, other)]
        return text if places[0] == places[1] and (self.document is None) == (other.document is None) else None

    # ---- Meanings

    def hover(self, offset: int) -> tuple[int, int, str] | None:
        """``(start, end, Markdown)``: the meaning of the word at an offset."""
        if here := self.at(offset):
            return here.start, here.end, self._of_symbol(here.symbol)
        i = bisect_right(self.tokens, offset, key=lambda token: token.start) - 1
        if i < 0 or offset >= self.tokens[i].end:
            return None
        token, before = self.tokens[i], self.tokens[i - 1].role
        text = OPERATORS.get(token.role, "")
        if token.role in ROLES:
            text = description(row(token.role, token.text))
        elif token.role == "WORD" and before in NAMED:
            text = _of_name(*NAMED[before], words.normalise(token.text))
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
        return words.BUILT_IN | {name: pattern.kind for name, pattern in patterns if pattern.kind}

    def _of_symbol(self, symbol: Symbol) -> str:
        """The definition of a symbol, as Markdown."""
        if symbol.kind == "name":
            return f"**${symbol.key}** = {self._names.get(symbol.key, '? It has no value in this text')}"
        if symbol.kind == "texture":
            return f"**{symbol.key}**: {self._textures.get(symbol.key, 'no TEXTURE has this name')}"
        starts = [token.start for token in self.tokens if token.role in STATEMENTS]
        ends = [*starts[1:], len(self.text)]
        defining = [bisect_right(starts, one.start) - 1 for one in self.occurrences(symbol) if one.defines]
        parts = "\n".join(self.text[starts[i] : ends[i]].strip() for i in defining)
        return f"```scn\n{parts}\n```" if parts else f"no SURFACE or TRANSFORM has the index {symbol.key}"

    # ---- Completion

    def completions(self, offset: int) -> list[Completion]:
        """The words that fit at an offset, in place of a partial word before it."""
        line = self.text[self.text.rfind("\n", 0, offset) + 1 : offset]
        if braces := BRACES.search(line):
            start = offset - len(braces[1])
            functions = [Completion(name, "Function", start, rank=2) for name in (*FUNCTIONS, *CONSTANTS)]
            return [*self._variables(start), *functions]
        start = offset - len((WORD.search(line) or [""])[0])
        before = Reader(self.text[:start])
        last, expected = before.scanner.last, before.expected
        unclosed = any(one.code == "unclosed" for one in before.errors[-1:]) and "RPAR" not in expected
        comment = before.tokens and before.tokens[-1].text.startswith("#") and before.tokens[-1].end == start
        if unclosed or comment or last.role == "END":
            return []
        if last.role in INDEXED:
            return [*self._indices(last.role, start), *self._variables(start)]
        takes = row(last.role, last.text).takes if last.role in ROLES else NOTHING
        if takes.count and not isinstance(takes, Flags):
            return self._variables(start)
        result = [one for role in words.ORDER if role in ROLES and role in expected for one in _words(role, start)]
        values = NAMED[last.role][1] if last.role in NAMED else self._textures if "TEXTURE_NAME" in expected else {}
        result += [Completion(name, "Color", start, value) for name, value in values.items()]
        if "USE" in expected:
            result += [Completion(name, "Class", start) for name in before.fields["solids"]]
        if {"NUMBER", "WORD"} & expected:
            result += self._variables(start)
        return result

    def _variables(self, start: int) -> list[Completion]:
        return [Completion(f"${name}", "Variable", start, value, rank=1) for name, value in self._names.items()]

    def _indices(self, role: str, start: int) -> list[Completion]:
        """Indices without this statement; after a primitive, indices with a statement."""
        given: dict[str, set[int]] = {keyword: set() for keyword in INDEXED}
        for symbol, found in self.table.items():
            for one in found if symbol.kind == "index" else ():
                given[one.after].add(int(symbol.key))
        used, defined = given["PRIMITIVE"] | given["USE"], given["SURFACE"] | given["TRANSFORM"]
        fitting = defined if role in ("PRIMITIVE", "USE") else (used | defined) - given[role]
        fitting = fitting or {max(set().union(*given.values()), default=-1) + 1}
        return [Completion(str(i), "Value", start) for i in sorted(fitting)]


def _words(role: str, start: int) -> Iterator[Completion]:
    """The keywords of a role: those of the statement before statements, canonical spellings before others."""
    kind, rank = ("Keyword", 2) if role in STATEMENTS else ("Property", 0)
    for word in words.of_role(role):
        for i, spelling in enumerate(word.spellings):
            yield Completion(spelling, kind, start, _takes(word), description(word), rank + (i > 0))


def _takes(word: Word) -> str:
    """The values after a word: ``x y z``, or nothing."""
    return " ".join(["TRUE"] * word.takes.count) if isinstance(word.takes, Flags) else word.takes.what


def description(word: Word) -> str:
    """A word's meaning, its values with their units and range, and its other spellings, as Markdown."""
    lines = [f"**{word.canonical}** {_takes(word)}".rstrip(), word.meaning]
    if word.takes.count and not isinstance(word.takes, Flags):
        each = "each " if word.takes.count > 1 else ""
        lines.append(f"{word.takes.what}: {each}{word.takes.bounds()}")
    lines += ["Of: " + ", ".join(word.of)] if word.of else []
    lines += ["Also: " + ", ".join(word.spellings[1:])] if word.spellings[1:] else []
    return "\n\n".join(lines)


def _of_name(what: str, names: dict[str, str], name: str) -> str:
    """The table or the material behind the name of a metal or a glass, and its other names, as Markdown."""
    if name not in names:
        return f"no {what} has this name"
    index = f": n-refr = {words.INDICES[names[name]]} at 587.6 nm" if what == "glass" else ""
    others = ", ".join(other for other in names if names[other] == names[name])
    return f"The {what} **{names[name]}**{index}\n\nNames: {others}"
