"""A scene in canonical layout, comments kept."""

from math import isfinite
from os import PathLike

from . import tokens
from .analysis import analyse
from .diagnostics import SceneError, together
from .expressions import written
from .reader import SYNTAX
from .tokens import Token
from .words import OPERATORS, STATEMENTS, row

INDENT = "    "
DEEPEST = 12  # steps to which the tree is indented
#: Statements with parameters on lines of their own.
HEADINGS = {"LIGHTS", "VIEW", "SOLID", "CSG_TREE", "SURFACE", "TRANSFORM", "TEXTURE"}
#: Tokens that stand on the line of the keyword before them; any other begins a line.
VALUES = tokens.VALUES - {"KIND"} | {"VARIABLE", "STRING", "LPAR", "RPAR"}


def format(text: str, filename: str | PathLike[str] = "<string>") -> str:
    """The text of a scene in canonical layout: one statement or parameter a line, canonical spellings, comments kept.

    ``parse(format(x)) == parse(x)`` and ``format(format(x)) == format(x)``; names and expressions stay as written.
    Raises :class:`SceneError` where ``parse`` does; in a scene with names that have no value, for syntax errors alone.
    """
    reader, found, _ = analyse(text, filename)
    syntax_only = reader.has_undefined and not reader.skipped
    errors = [one for one in found if isinstance(one, SceneError) and (one.code in SYNTAX or not syntax_only)]
    if errors:
        raise together(errors)
    layout = _Layout(text)
    end = 0
    for token in reader.tokens:
        layout.add(token, same_line="\n" not in text[end : token.start])
        end = token.end
    return layout.text()


class _Line:
    """A line of the result: its words, and the comments behind them."""

    def __init__(self, indent: str, *words: str) -> None:
        self.indent, self.words, self.comments = indent, list(words), list[str]()

    def __str__(self) -> str:
        # A comment with # ends its line, so it comes last.
        comments = sorted(self.comments, key=lambda comment: comment.startswith("#"))
        return self.indent + " ".join([*self.words, *comments]) if self.words or comments else ""


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

    def add(self, token: Token, same_line: bool) -> None:
        if token.role == "REST":
            self.rest = token.text.rstrip()
        elif token.role == "COMMENT":
            if not (self.lines and same_line):
                self.lines.append(_Line(INDENT if self.heading in HEADINGS else ""))
            self.lines[-1].comments.append("\n".join(line.rstrip() for line in token.text.split("\n")))
        else:
            self.token(token)
            self.previous = token.role

    def token(self, token: Token) -> None:
        kind = token.role
        if kind in STATEMENTS:
            if kind in HEADINGS or self.heading in HEADINGS:
                self.blank_line()
            self.heading = kind
            self.begin(
                0, row(kind, token.text).canonical + ("" if kind in HEADINGS or kind in ("DEFAULT", "END") else ":")
            )
        elif kind in VALUES:
            self.value(token)
        elif kind == "MINUS" and self.heading == "VIEW":
            pass  # the stray dash of the listing
        elif kind in OPERATORS.values():
            self.operator(token)
        elif kind in ("PRIMITIVE", "USE"):
            self.begin_node(token.text if kind == "USE" else row(kind, token.text).canonical)
            self.operand()
        else:
            # A light's parameters stand below its kind.
            self.begin(2 if kind in ("LIGHT_PARAMETER", "DISTRIBUTION") else 1, row(kind, token.text).canonical)

    def operator(self, token: Token) -> None:
        """Operators that follow one another stand on one line, all their operands below, one step to the right."""
        if self.previous not in OPERATORS.values():
            self.begin_node(token.text)
            self.missing.append(2)
            return
        self.missing[-1] += 1
        if self.lines[-1] is self.line and not self.line.comments:
            self.line.words.append(token.text)
        else:  # a comment stands between
            self.begin(self.depth(len(self.missing)), token.text)

    def begin_node(self, word: str) -> None:
        """A line of the tree, and the comments that stand directly above it."""
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

    def value(self, token: Token) -> None:
        kind, words = token.role, self.line.words
        if kind == "LPAR" or kind == "RPAR":
            return  # set around the numbers of any step
        as_written = self.source[token.start : token.end]
        if as_written[:1] in ("$", "{"):
            text = as_written
        elif kind == "NUMBER":
            value = float(token.text)
            text = written(value) if self.heading != "NAME" and isfinite(value) else token.text
        elif kind == "STRING":
            text = f'"{token.text}"'
        elif kind in ("WORD", "FILE", "TEXTURE_NAME"):
            text = token.text
        else:
            text = row(kind, token.text).canonical
        if self.heading == "TRANSFORM" and self.line.indent:
            words[-1:] = [words[-1], f"({text})"] if len(words) == 1 else [f"{words[-1][:-1]} {text})"]
            return
        if self.previous == "VARIABLE" and self.heading == "DEFAULT":
            words.append("=")
        if self.heading in ("SURFACE", "TEXTURE") and self.line.indent and len(words) == 1 and words[0] != "material":
            words.append("=")
        words.append(text)

    def blank_line(self) -> None:
        """A blank line before what begins now, and before the comments that stand directly above it."""
        at = len(self.lines)
        while at and not self.lines[at - 1].words:
            at -= 1
            self.lines[at].indent = ""
        if at:
            self.lines.insert(at, _Line(""))
