"""The canonical layout of a scene; comments stay."""

from dataclasses import dataclass, field
from math import isfinite
from os import PathLike

from . import tokens
from .analysis import analyse
from .diagnostics import SceneError, combined_error
from .expressions import written
from .tokens import Token
from .words import OPERATORS, ROLES, STATEMENTS, row

INDENT = "    "
MAX_DEPTH = 12  # the largest indentation of the tree, in steps
#: Statements with parameters on lines of their own.
HEADINGS = {"LIGHTS", "VIEW", "SOLID", "CSG_TREE", "SURFACE", "TRANSFORM", "TEXTURE"}
#: Tokens on the line of the keyword before them; any other token begins a line.
VALUES = tokens.VALUES - {"KIND"} | {"VARIABLE", "STRING", "LPAR", "RPAR"}


def format(text: str, filename: str | PathLike[str] = "<string>") -> str:
    """The text of a scene in canonical layout: one statement or parameter per line, canonical spellings; comments stay.

    ``parse(format(x)) == parse(x)`` and ``format(format(x)) == format(x)``; names and expressions stay as written.
    Raises :class:`SceneError` where ``parse`` does, except for names without a value.
    """
    reader, found, _ = analyse(text, filename)
    errors = [one for one in found if isinstance(one, SceneError) and one.code != "undefined"]
    if errors:
        raise combined_error(errors)
    layout, end = _Layout(text), 0
    for token in reader.tokens:
        if token.role == "COMMENT":
            layout.comment(token, same_line="\n" not in text[end : token.start])
        else:
            layout.token(token)
        end = token.end
    return "\n".join([*map(str, layout.lines), ""])


@dataclass
class _Line:
    """A line of the result: its indentation in steps, its words, the ``mark`` before its values, and its comments."""

    depth: int
    words: list[str] = field(default_factory=list)
    mark: str = ""
    comments: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        word, values = self.words[:1], self.words[1:]
        if values and self.mark:
            values = ["=", *values] if self.mark == "=" else [f"({' '.join(values)})"]
        # A comment with # ends its line, so it comes last.
        comments = sorted(self.comments, key=lambda comment: comment.startswith("#"))
        words = " ".join([*word, *values, *comments])
        return INDENT * min(self.depth, MAX_DEPTH) + words if words else ""


class _Layout:
    """The lines of the result so far."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.lines: list[_Line] = []
        self.line = _Line(0)  # the last line with words
        self.heading = self.previous = ""  # the statement, and the role of the token before
        self.missing: list[int] = []  # the missing operands of the runs of operators around a node of the tree

    def begin(self, depth: int, word: str, above: int, mark: str = "") -> int:
        """Adds a line; comments directly above it get the depth ``above``. Returns the number of the first of them."""
        at = len(self.lines)
        while at and not self.lines[at - 1].words:
            at -= 1
            self.lines[at].depth = above
        self.line = _Line(depth, [word], mark)
        self.lines.append(self.line)
        return at

    def comment(self, token: Token, same_line: bool) -> None:
        """Adds a comment after the words of its line, or on a separate line."""
        if not (self.lines and same_line):
            self.lines.append(_Line(self.heading in HEADINGS))
        self.lines[-1].comments.append("\n".join(line.rstrip() for line in token.text.split("\n")))

    def token(self, token: Token) -> None:
        """Adds any other token."""
        kind = token.role
        if kind in VALUES:
            self.value(token)
        elif kind in STATEMENTS:
            colon = "" if kind in HEADINGS or kind in ("DEFAULT", "END") else ":"
            at = self.begin(0, row(kind, token.text).canonical + colon, 0, "=" * (kind == "DEFAULT"))
            if at and {kind, self.heading} & HEADINGS:
                self.lines.insert(at, _Line(0))
            self.heading = kind
        elif kind in OPERATORS.values():
            self.operator(token)
        elif kind in ("PRIMITIVE", "USE"):
            depth = len(self.missing) + 1
            self.begin(depth, token.text if kind == "USE" else row(kind, token.text).canonical, depth)
            while self.missing:  # a complete run of operators is an operand itself
                self.missing[-1] -= 1
                if self.missing[-1]:
                    break
                self.missing.pop()
        elif kind == "REST":
            self.begin(0, token.text.rstrip(), 0)
        else:
            # A light's parameters are below its kind.
            depth = 2 if kind in ("LIGHT_PARAMETER", "DISTRIBUTION") else 1
            mark = (
                "" if kind == "MATERIAL" else {"SURFACE": "=", "TEXTURE": "=", "TRANSFORM": "("}.get(self.heading, "")
            )
            self.begin(depth, row(kind, token.text).canonical, 1, mark)
        self.previous = kind

    def operator(self, token: Token) -> None:
        """Adds an operator: successive operators are on one line, their operands below, one step to the right."""
        if self.heading == "VIEW":
            return  # the stray dash of the listing
        if self.previous not in OPERATORS.values():
            depth = len(self.missing) + 1
            self.begin(depth, token.text, depth)
            self.missing.append(2)
            return
        self.missing[-1] += 1
        if self.lines[-1] is self.line and not self.line.comments:
            self.line.words.append(token.text)
        else:  # a comment is between them
            self.begin(len(self.missing), token.text, 1)

    def value(self, token: Token) -> None:
        """Adds a value after its keyword."""
        kind, text = token.role, self.source[token.start : token.end]
        if kind in ("LPAR", "RPAR"):
            return  # the layout adds parentheses around the numbers of each step
        if kind == "VARIABLE":
            self.line.words[0] += f" {text}"
            return
        if text[0] in "${":
            pass
        elif kind == "NUMBER" and self.heading != "NAME" and isfinite(float(text)):
            text = written(float(text))
        elif kind in ROLES:
            text = row(kind, token.text).canonical
        self.line.words.append(text)
