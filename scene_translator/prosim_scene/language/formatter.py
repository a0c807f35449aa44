"""A scene in canonical layout, remarks kept."""

import warnings
from os import PathLike

from lark import Token

from . import document_of
from .definitions import Definitions
from .messages import Source
from .parser import tokens_and_tree
from .words import OPERATORS, STATEMENTS, row

INDENT = "    "
DEEPEST = 12  # steps to which the tree is indented
#: Statements with parameters on lines of their own.
HEADINGS = {"LIGHTS", "VIEW", "CSG_TREE", "SURFACE", "TRANSFORM", "TEXTURE"}
#: Tokens that stand on the line of the keyword before them; any other begins a line.
VALUES = {
    "NUMBER",
    "VARIABLE",
    "WORD",
    "STRING",
    "FILE",
    "TEXTURE_NAME",
    "BOOL",
    "NULL",
    "CONDUCTOR",
    "DIELECTRIC",
    "MATERIAL_KIND",
    "LPAR",
    "RPAR",
}


def format(text: str, filename: str | PathLike[str] = "<string>") -> str:
    """The text of a scene in canonical layout: one statement or parameter a line, canonical spellings, remarks kept.

    ``parse(format(x)) == parse(x)``, and what is formatted stays as it is; names and what stands in braces are kept as
    they are written. Raises :class:`SceneError` where ``parse`` would; but of a scene with names that have no value the
    syntax alone is judged.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        source = Source(text, filename)
        definitions = Definitions(source, tolerant=True)
        pieces, _ = tokens_and_tree(source, definitions)
        if not definitions.undefined:
            document_of(text, filename)
    layout = _Layout(text)
    end = 0
    for piece in pieces:
        layout.add(piece, same_line="\n" not in text[end : piece.start_pos])
        end = piece.end_pos or 0
    return layout.text()


class _Line:
    """A line of the result: its words, and the remarks behind them."""

    def __init__(self, indent: str, *words: str) -> None:
        self.indent, self.words, self.remarks = indent, list(words), list[str]()

    def __str__(self) -> str:
        # A remark with # ends its line, so it comes last.
        remarks = sorted(self.remarks, key=lambda remark: remark.startswith("#"))
        return self.indent + " ".join([*self.words, *remarks]) if self.words or remarks else ""


class _Layout:
    """The lines so far."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.lines: list[_Line] = []
        self.line = _Line("")  # the last one that has words
        self.heading = self.previous = ""  # the statement, and the type of the token before
        self.rest = ""  # what follows END
        self.missing: list[int] = []  # operands that the runs of operators around a node of the tree still lack

    def text(self) -> str:
        return "\n".join([*map(str, self.lines), *([self.rest] if self.rest else []), ""])

    def begin(self, depth: int, *words: str) -> None:
        self.line = _Line(INDENT * depth, *words)
        self.lines.append(self.line)

    def add(self, piece: Token, same_line: bool) -> None:
        if piece.type == "REST":
            self.rest = piece.value.rstrip()
        elif piece.type == "REMARK":
            if not (self.lines and same_line):
                self.lines.append(_Line(INDENT if self.heading in HEADINGS else ""))
            self.lines[-1].remarks.append("\n".join(line.rstrip() for line in piece.value.split("\n")))
        else:
            self.token(piece)
            self.previous = piece.type

    def token(self, piece: Token) -> None:
        kind = piece.type
        if kind in STATEMENTS:
            if kind in HEADINGS or self.heading in HEADINGS:
                self.blank_line()
            self.heading = kind
            self.begin(0, row(piece).canonical + ("" if kind in HEADINGS or kind in ("DEFAULT", "END") else ":"))
        elif kind in VALUES:
            self.value(piece)
        elif kind == "MINUS" and self.heading == "VIEW":
            pass  # the stray dash of the listing
        elif kind in OPERATORS.values():
            self.operator(piece)
        elif kind == "PRIMITIVE":
            self.begin_node(row(piece).canonical)
            self.operand()
        else:
            # A light's parameters stand below its kind.
            self.begin(2 if kind in ("LIGHT_PARAMETER", "DISTRIBUTION") else 1, row(piece).canonical)

    def operator(self, piece: Token) -> None:
        """Operators that follow one another stand on one line, all their operands below, one step to the right."""
        if self.previous not in OPERATORS.values():
            self.begin_node(str(piece))
            self.missing.append(2)
            return
        self.missing[-1] += 1
        if self.lines[-1] is self.line and not self.line.remarks:
            self.line.words.append(str(piece))
        else:  # a remark stands between
            self.begin(self.depth(len(self.missing)), str(piece))

    def begin_node(self, word: str) -> None:
        """A line of the tree, and the remarks that stand directly above it."""
        depth = self.depth(len(self.missing) + 1)
        for line in reversed(self.lines):
            if line.words:
                break
            line.indent = INDENT * depth
        self.begin(depth, word)

    def operand(self) -> None:
        """One operand less is missing, and the run of operators that lacks none is one itself."""
        while self.missing:
            self.missing[-1] -= 1
            if self.missing[-1]:
                break
            self.missing.pop()

    @staticmethod
    def depth(level: int) -> int:
        """Steps to the right: so few that a line stays readable, and the text of a deep tree in proportion."""
        return min(level, DEEPEST)

    def value(self, piece: Token) -> None:
        kind, words = piece.type, self.line.words
        if kind == "LPAR" or kind == "RPAR":
            return  # set around the numbers of any step
        as_written = self.source[piece.start_pos : piece.end_pos]
        if as_written[:1] in ("$", "{"):
            text = as_written
        elif kind == "NUMBER":
            text = str(piece) if self.heading == "NAME" else _number(piece)
        elif kind == "STRING":
            text = f'"{piece}"'
        elif kind in ("WORD", "FILE", "TEXTURE_NAME"):
            text = str(piece)
        else:
            text = row(piece).canonical
        if self.heading == "TRANSFORM" and self.line.indent:
            words[-1:] = [words[-1], f"({text})"] if len(words) == 1 else [f"{words[-1][:-1]} {text})"]
            return
        if self.previous == "VARIABLE" and self.heading == "DEFAULT":
            words.append("=")
        if self.heading in ("SURFACE", "TEXTURE") and self.line.indent and len(words) == 1 and words[0] != "material":
            words.append("=")
        words.append(text)

    def blank_line(self) -> None:
        """A blank line before what begins now, and before the remarks that stand directly above it."""
        at = len(self.lines)
        while at and not self.lines[at - 1].words:
            at -= 1
            self.lines[at].indent = ""
        if at:
            self.lines.insert(at, _Line(""))


def _number(text: str) -> str:
    value = float(text)
    return str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(value)
