"""Finds the symbols in a scene's text (indices, textures, solids and ``$names``), completions, and the meanings of
words, for an editor.
"""

import re
from bisect import bisect_right
from collections.abc import Iterator, Mapping
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from lsprotocol.types import CompletionItem, CompletionItemKind, MarkupContent, MarkupKind

from ..language import words
from ..language.analysis import analyse
from ..language.diagnostics import USE, SceneError
from ..language.expressions import CONSTANTS, FPS, FRAME, FUNCTIONS, TIME
from ..language.reader import KEYED, Reader
from ..language.tokens import START, Token
from ..language.words import NAMED, NO_NUMBERS, ROLES, STATEMENTS, Word, find_word

#: The grammar roles of keywords before an index.
INDEXED = ("SURFACE", "TRANSFORM", "PRIMITIVE", "USE")
#: Matches a character before a word.
BEFORE_WORD = re.compile(r'[\s()#":=]')
#: Matches the arithmetic in braces before the cursor.
BRACES = re.compile(r"\{(?:[^{}\n]*[^{}\n$\w])?([$\w]*)\Z")


class Symbol(NamedTuple):
    """A symbol of a scene: its ``kind`` is "index", "texture", "solid" or "name" (a ``$name``), and its ``key`` is the
    number or the name.
    """

    kind: str
    key: str


class Occurrence(NamedTuple):
    """A use or a definition of a symbol, from the text offset ``start`` to ``end``."""

    symbol: Symbol
    start: int
    end: int
    defines: bool


class Symbols:
    """The text of a scene, as empty if it is too large, its errors and warnings, and the table of its symbols."""

    def __init__(self, text: str, path: Path | str | None = None) -> None:
        self.reader, self.diagnostics, self.document = analyse(text, str(path or "<string>"))
        self.text = self.reader.source.text
        #: The ``$names`` that have a value in this text, each with the text of its value.
        self.names = {FRAME: "0", TIME: f"${FRAME} / {FPS:g}"} | self.reader.definitions.defaults
        patterns = self.reader.fields["patterns"].items()
        #: The names of the textures that this text may use, each with its kind.
        self.textures = {name: pattern.kind for name, pattern in patterns if pattern.kind}

    @cached_property
    def tokens(self) -> list[Token]:
        """All tokens of the text except comments."""
        return [token for token in self.reader.tokens if token.role != "COMMENT"]

    @cached_property
    def statements(self) -> list[Token]:
        """The statements of the text: each has the role of its keyword, and as text its name, which is its keyword,
        with the index or the name that follows it.
        """
        first = [i for i, token in enumerate(self.tokens) if token.role in STATEMENTS]
        result = []
        for i, following in pairwise([*first, len(self.tokens)]):
            words = self.tokens[i : min(i + 1 + (self.tokens[i].role in KEYED), following)]
            name = " ".join(self.text[token.start : token.end] for token in words)
            result.append(Token(words[0].role, name, words[0].start, self.tokens[following - 1].end))
        return result

    @cached_property
    def table(self) -> dict[Symbol, list[Occurrence]]:
        """A dictionary from each symbol to the symbol's occurrences, in the order of the text."""
        result: dict[Symbol, list[Occurrence]] = {}
        for before, token in pairwise([START, *self.tokens]):
            for occurrence in self._occurrences(token, before.role):
                result.setdefault(occurrence.symbol, []).append(occurrence)
        return result

    def _occurrences(self, token: Token, before: str) -> Iterator[Occurrence]:
        """Yields the occurrences of symbols in a token; ``before`` is the grammar role of the previous token."""
        if self.text[token.start] in "${":
            for match in USE.finditer(self.text, token.start, token.end):
                yield Occurrence(Symbol("name", match[1]), *match.span(), token.role == "VARIABLE")
        elif token.role == "NUMBER" and before in INDEXED and re.fullmatch("[0-9]{1,9}", token.text):
            yield Occurrence(Symbol("index", str(int(token.text))), *token.span, before in STATEMENTS)
        elif token.role == "TEXTURE_NAME":
            yield Occurrence(Symbol("texture", words.texture_name(token.text)), *token.span, before == "TEXTURE")
        elif token.role == "USE" or before == "SOLID":
            yield Occurrence(Symbol("solid", words.normalise(token.text)), *token.span, before == "SOLID")

    def occurrence_at(self, offset: int) -> Occurrence | None:
        """Returns the first occurrence of a symbol that contains or ends at ``offset``; None without one."""
        occurrences = (occurrence for found in self.table.values() for occurrence in found)
        return min((o for o in occurrences if o.start <= offset <= o.end), key=lambda o: o.start, default=None)

    def renamed(self, symbol: Symbol, name: str) -> list[tuple[int, int, str]] | None:
        """Returns edits ``(start, end, text)`` to another name; None if it is not allowed, or already used."""
        text, uses = self.text, self.table[symbol]
        new = "$" * (symbol.kind == "name") + name.removeprefix("$")
        edits = [(use.start, use.end, new) for use in uses]
        for start, end, new in reversed(edits):
            text = text[:start] + new + text[end:]
        changed = Symbols(text)
        counts = [sum(isinstance(one, SceneError) for one in own.diagnostics) for own in (self, changed)]
        key = Symbol(symbol.kind, words.texture_name(name.removeprefix("$")) if symbol.kind != "name" else new[1:])
        known = key.key in self.names if symbol.kind == "name" else key.key in self.textures
        valid = counts[0] >= counts[1] and len(changed.table.get(key, [])) == len(uses)
        return edits if valid and not known else None

    # ---- Meanings

    def hover(self, offset: int) -> tuple[int, int, str] | None:
        """Returns ``(start, end, Markdown)``: the meaning of the word at ``offset``, or a symbol's definition."""
        if occurrence := self.occurrence_at(offset):
            return occurrence.start, occurrence.end, self._symbol_markdown(occurrence.symbol)
        i = bisect_right(self.tokens, offset, key=lambda token: token.start) - 1
        if i < 0 or offset >= self.tokens[i].end:
            return None
        token, before = self.tokens[i], self.tokens[max(i - 1, 0)].role
        text = words.TOKEN_MEANINGS.get(token.role, "")
        if token.role in ROLES:
            text = description(find_word(token.role, token.text))
        elif token.role == "WORD" and before in NAMED:
            text = _name_markdown(*NAMED[before], words.normalise(token.text))
        return (token.start, token.end, text) if text else None

    def _symbol_markdown(self, symbol: Symbol) -> str:
        """Returns the definition of a symbol as Markdown, or a note that the text does not define the symbol."""
        if symbol.kind == "name":
            return f"**${symbol.key}** = {self.names.get(symbol.key, '? It has no value in this text')}"
        if symbol.kind == "texture":
            return f"**{symbol.key}**: {self.textures.get(symbol.key, 'no TEXTURE has this name')}"
        defining = [use.start for use in self.table[symbol] if use.defines]
        statements = [one for one in self.statements if any(one.start <= start < one.end for start in defining)]
        parts = "\n".join(self.text[one.start : one.end] for one in statements)
        return f"```scn\n{parts}\n```" if parts else f"no SURFACE or TRANSFORM has the index {symbol.key}"

    # ---- Completion

    def completions(self, offset: int) -> tuple[int, list[CompletionItem]]:
        """Returns ``(start, items)``: the words that the language allows at the text offset ``offset``; each word can
        replace the partial word from ``start`` to this offset.

        In the braces of an expression, the words are ``$names``, functions and constants. Where only numbers fit, the
        words are ``$names``, and indices if the number is an index. Elsewhere, the words are the keywords that fit, the
        names of metals, glasses, textures and solids where such a name fits, and ``$names`` where a number fits. In a
        comment, in a quote and after END, the list is empty, except after an open brace on the same line.
        """
        line = self.text[self.text.rfind("\n", 0, offset) + 1 : offset]
        names = [_completion(f"${name}", "Variable", value, rank=1) for name, value in self.names.items()]
        if braces := BRACES.search(line):  # arithmetic
            functions = [_completion(name, "Function", rank=2) for name in (*FUNCTIONS, *CONSTANTS)]
            return offset - len(braces[1]), [*names, *functions]
        start = offset - len(BEFORE_WORD.split(line)[-1])
        reader = Reader(self.text[:start])
        last, expected = reader.last, reader.expected
        unclosed = any(one.code == "unclosed" for one in reader.errors[-1:]) and "RPAR" not in expected
        comment = reader.tokens and reader.tokens[-1].text.startswith("#") and reader.tokens[-1].end == start
        if unclosed or comment or last.role == "END":  # no word fits inside a comment or a quote, or after END
            return start, []
        if last.role in INDEXED:
            return start, [*self._index_completions(last.role), *names]
        numbers = find_word(last.role, last.text).numbers if last.role in ROLES else NO_NUMBERS
        if numbers.count and not numbers.flags:  # only numbers, or names of numbers, fit
            return start, names
        fitting = [role for role in words.ORDER if role in expected and role in ROLES]
        spellings = self.reader.source.spellings
        result = [one for role in fitting for one in _keyword_completions(role, spellings)]
        values = {spellings.get(name, name): kind for name, kind in self.textures.items() if "TEXTURE_NAME" in expected}
        values = NAMED[last.role][1] if last.role in NAMED else values
        result += [_completion(name, "Color", value) for name, value in values.items()]
        if "USE" in expected:
            result += [_completion(name, "Class") for name in reader.fields["solids"]]
        return start, result + (names if {"NUMBER", "WORD"} & expected else [])

    def _index_completions(self, role: str) -> list[CompletionItem]:
        """Lists the completions for an index after a keyword with the grammar role ``role``."""
        spans, indices = self.reader.spans, sorted(int(key) for kind, key in self.table if kind == "index")
        if role in STATEMENTS:
            fitting = [i for i in indices if (words.words_of(role)[0].name, i) not in spans]
        else:
            fitting = [i for i in indices if ("surfaces", i) in spans or ("transforms", i) in spans]
        return [_completion(str(i), "Value") for i in fitting or [max(indices, default=-1) + 1]]


def _completion(label: str, kind: str, detail: str = "", documentation: str = "", rank: int = 0) -> CompletionItem:
    """Returns a completion; ``detail``, the names of its numbers or its value, stands beside it.

    A lower ``rank`` comes first: what continues the statement, and preferred spellings. Within a rank, the editor sorts
    indices by number, and words by letter.
    """
    return CompletionItem(
        label,
        kind=CompletionItemKind[kind],
        detail=detail or None,
        documentation=MarkupContent(MarkupKind.Markdown, documentation) if documentation else None,
        sort_text=f"{rank}{label.zfill(9) if kind == 'Value' else label}",
    )


def _keyword_completions(role: str, spellings: Mapping[str, str]) -> Iterator[CompletionItem]:
    """Yields a completion for each spelling of the keywords that have the grammar role ``role``."""
    kind, rank = ("Keyword", 2) if role in STATEMENTS else ("Property", 0)
    for word in words.words_of(role):
        preferred = spellings.get(word.canonical, word.canonical)
        for spelling in word.spellings:
            other = spelling != preferred
            yield _completion(spelling, kind, _names_of_numbers(word), description(word), rank + other)


def _names_of_numbers(word: Word) -> str:
    return " ".join(["TRUE"] * word.numbers.count) if word.numbers.flags else word.numbers.names


def description(word: Word) -> str:
    """Returns a description of a word of the language as Markdown: the word with the names of its numbers, its meaning,
    the range of the numbers, the kinds of lights, materials or textures that have it, and its other spellings.
    """
    lines = [f"**{word.canonical}** {_names_of_numbers(word)}".rstrip(), word.meaning]
    if word.numbers.count and not word.numbers.flags:
        each = "each " if word.numbers.count > 1 else ""
        lines.append(f"{word.numbers.names}: {each}{word.numbers.range_in_words()}")
    lines += ["Of: " + ", ".join(word.kinds)] if word.kinds else []
    lines += ["Also: " + ", ".join(word.spellings[1:])] if word.spellings[1:] else []
    return "\n\n".join(lines)


def _name_markdown(kind: str, names: dict[str, str], name: str) -> str:
    if name not in names:
        return f"no {kind} has this name"
    index = f": n-refr = {words.INDICES[names[name]]} at 587.6 nm" if kind == "glass" else ""
    others = ", ".join(other for other in names if names[other] == names[name])
    return f"The {kind} **{names[name]}**{index}\n\nNames: {others}"
