"""The canonical layout of a scene; comments stay."""

from dataclasses import dataclass, field
from math import isfinite

from . import tokens
from .analysis import analyse
from .diagnostics import AnyPath, SceneError, combined_error
from .expressions import number_text
from .tokens import Token
from .words import OPERATORS, ROLES, STATEMENTS, find_word

INDENT = "    "
MAX_DEPTH = 12  # the largest indentation of the tree, in steps
#: Statements with parameters on lines of their own.
HEADINGS = {"LIGHTS", "VIEW", "SOLID", "CSG_TREE", "SURFACE", "TRANSFORM", "TEXTURE"}
#: Statement -> the mark before the values of its parameters.
VALUE_MARKS = {"SURFACE": "=", "TEXTURE": "=", "TRANSFORM": "("}
#: Tokens on the line of the keyword before them; any other token begins a line.
VALUES = tokens.VALUES - {"KIND"} | {"VARIABLE", "STRING", "LPAR", "RPAR"}


def format(text: str, filename: AnyPath = "<string>") -> str:
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
            layout.add_comment(token, same_line="\n" not in text[end : token.start])
        else:
            layout.add_token(token)
        end = token.end
    return "\n".join([*map(str, layout.lines), ""])


@dataclass
class _Line:
    """A line of the formatted text: indentation in steps, words, the ``mark`` before the values, and comments."""

    depth: int
    words: list[str] = field(default_factory=list)
    mark: str = ""
    comments: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        """The text of the line."""
        word, values = self.words[:1], self.words[1:]
        if values and self.mark:
            values = ["=", *values] if self.mark == "=" else [f"({' '.join(values)})"]
        # A comment with # ends its line, so it comes last.
        comments = sorted(self.comments, key=lambda comment: comment.startswith("#"))
        words = " ".join([*word, *values, *comments])
        return INDENT * min(self.depth, MAX_DEPTH) + words if words else ""


class _Layout:
    """The lines of the formatted text so far."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.lines: list[_Line] = []
        self.line = _Line(0)  # the last line with words
        self.heading = self.previous = ""  # the statement, and the role of the token before
        self.missing_operands: list[int] = []  # the missing operands of the runs of operators around a node of the tree

    def add_line(self, depth: int, word: str, comment_depth: int, mark: str = "") -> int:
        """Adds a line; returns its number, or that of the first comment directly above it.

        These comments get the depth ``comment_depth``.
        """
        at = len(self.lines)
        while at and not self.lines[at - 1].words:
            at -= 1
            self.lines[at].depth = comment_depth
        self.line = _Line(depth, [word], mark)
        self.lines.append(self.line)
        return at

    def add_comment(self, token: Token, same_line: bool) -> None:
        """Adds a comment after the words of its line, or on a separate line."""
        if not (self.lines and same_line):
            self.lines.append(_Line(self.heading in HEADINGS))
        self.lines[-1].comments.append("\n".join(line.rstrip() for line in token.text.split("\n")))

    def add_token(self, token: Token) -> None:
        """Adds a token that is not a comment."""
        kind = token.role
        if kind in VALUES:
            self.add_value(token)
        elif kind in STATEMENTS:
            colon = "" if kind in HEADINGS or kind in ("DEFAULT", "END") else ":"
            at = self.add_line(0, find_word(kind, token.text).canonical + colon, 0, "=" * (kind == "DEFAULT"))
            if at and {kind, self.heading} & HEADINGS:
                self.lines.insert(at, _Line(0))
            self.heading = kind
        elif kind in OPERATORS.values():
            self.add_operator(token)
        elif kind in ("PRIMITIVE", "USE"):
            depth = len(self.missing_operands) + 1
            self.add_line(depth, token.text if kind == "USE" else find_word(kind, token.text).canonical, depth)
            while self.missing_operands:  # a complete run of operators is an operand itself
                self.missing_operands[-1] -= 1
                if self.missing_operands[-1]:
                    break
                self.missing_operands.pop()
        elif kind == "REST":
            self.add_line(0, token.text.rstrip(), 0)
        else:
            # A light's parameters are below its kind.
            depth = 2 if kind in ("LIGHT_PARAMETER", "DISTRIBUTION") else 1
            mark = "" if kind == "MATERIAL" else VALUE_MARKS.get(self.heading, "")
            self.add_line(depth, find_word(kind, token.text).canonical, 1, mark)
        self.previous = kind

    def add_operator(self, token: Token) -> None:
        """Adds an operator: successive operators are on one line, their operands below, one step to the right."""
        if self.heading == "VIEW":
            return  # the stray dash of the listing
        if self.previous not in OPERATORS.values():
            depth = len(self.missing_operands) + 1
            self.add_line(depth, token.text, depth)
            self.missing_operands.append(2)
            return
        self.missing_operands[-1] += 1
        if self.lines[-1] is self.line and not self.line.comments:
            self.line.words.append(token.text)
        else:  # a comment is between them
            self.add_line(len(self.missing_operands), token.text, 1)

    def add_value(self, token: Token) -> None:
        """Adds a value after its keyword; names and expressions stay as written."""
        text = self.source[token.start : token.end]
        if token.role == "VARIABLE":
            self.line.words[0] += f" {text}"
            return
        if token.role == "NUMBER" and text[0] not in "${" and self.heading != "NAME" and isfinite(float(text)):
            text = number_text(float(text))
        elif token.role in ROLES and text[0] not in "${":
            text = find_word(token.role, token.text).canonical
        if token.role not in ("LPAR", "RPAR"):  # the line adds parentheses
            self.line.words.append(text)
