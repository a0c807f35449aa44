"""Writes a scene in the canonical layout, and keeps the comments."""

from dataclasses import dataclass, field

from . import tokens
from .analysis import analyse
from .diagnostics import AnyPath, SceneError, combined_error
from .tokens import Token
from .words import OPERATORS, STATEMENTS

INDENT = "    "
MAX_DEPTH = 12  # the largest indentation of a node of the CSG tree, in units of INDENT
#: Statements whose parameters are on separate lines.
HEADINGS = {"LIGHTS", "METHOD", "VIEW", "SOLID", "CSG_TREE", "SURFACE", "TRANSFORM", "TEXTURE"}
#: Statement -> the mark between a parameter's keyword and its values.
VALUE_MARKS = {"SURFACE": "=", "TEXTURE": "=", "TRANSFORM": "("}
#: The roles of tokens that stay on the line of the keyword before them; any other token begins a new line.
VALUES = tokens.VALUES - {"KIND"} | {"VARIABLE", "STRING", "LPAR", "RPAR", "SHAPE_PARAMETER"}


def format(text: str, filename: AnyPath = "<string>") -> str:
    """Returns the text of a scene in the canonical layout: one statement or parameter per line.

    Words, numbers and comments are not changed. ``parse(format(x)) == parse(x)`` and ``format(format(x)) ==
    format(x)``. Raises :class:`SceneError` for the same errors as ``parse``, except for ``$names`` without a value.
    """
    reader, problems, _ = analyse(text, filename)
    errors = [problem for problem in problems if isinstance(problem, SceneError) and problem.code != "undefined"]
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
    """A formatted line: its indentation, words, the mark between its keyword and its values, and comments."""

    depth: int
    words: list[str] = field(default_factory=list)
    mark: str = ""
    comments: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        word, values = self.words[:1], self.words[1:]
        if values and self.mark:
            values = ["=", *values] if self.mark == "=" else [f"({' '.join(values)})"]
        # A comment that begins with # extends to the end of the line, so it must be the last one.
        comments = sorted(self.comments, key=lambda comment: comment.startswith("#"))
        words = " ".join([*word, *values, *comments])
        return INDENT * min(self.depth, MAX_DEPTH) + words if words else ""


class _Layout:
    def __init__(self, source: str) -> None:
        self.source = source
        self.lines: list[_Line] = []
        self.line = _Line(0)  # the last line with words
        self.heading = ""  # the current statement
        self.missing_operands: list[int] = []  # how many operands each enclosing run of operators still lacks

    def add_line(self, depth: int, word: str, mark: str = "") -> int:
        """Adds a line with ``word`` and the ``mark`` after it, "=", "(" or ""; comments right above get the same
        indentation. Returns its number, or that of the first of these comments.
        """
        at = len(self.lines)
        while at and not self.lines[at - 1].words:  # a line without words is a comment
            at -= 1
            self.lines[at].depth = depth
        self.line = _Line(depth, [word], mark)
        self.lines.append(self.line)
        return at

    def add_comment(self, token: Token, same_line: bool) -> None:
        """Adds a comment to the last line if ``same_line`` is True and there is a line, or else on a separate line."""
        if not (self.lines and same_line):
            self.lines.append(_Line(self.heading in HEADINGS))
        self.lines[-1].comments.append("\n".join(line.rstrip() for line in token.text.split("\n")))

    def add_token(self, token: Token) -> None:
        """Adds a value to the line, a node by :meth:`add_node`, or another token on a new line; a blank line separates
        statements with parameters on separate lines.
        """
        kind, text = token.role, self.source[token.start : token.end]
        if kind in VALUES:
            # str(line) adds the parentheses; an equals sign follows the name after DEFAULT.
            self.line.words += [] if kind in ("LPAR", "RPAR") else [f"{text} =" if kind == "VARIABLE" else text]
        elif kind in STATEMENTS:
            colon = "" if kind in HEADINGS or kind in ("DEFAULT", "END") else ":"
            at = self.add_line(0, text + colon)
            if at and {kind, self.heading} & HEADINGS:
                self.lines.insert(at, _Line(0))
            self.heading = kind
        elif kind in (*OPERATORS.values(), "PRIMITIVE", "USE"):
            self.add_node(token, text)
        else:
            # The parameters of a light are below the kind of the light, one step to the right.
            depth = 2 if kind in ("LIGHT_PARAMETER", "DISTRIBUTION") else 1
            mark = "" if kind == "MATERIAL" else VALUE_MARKS.get(self.heading, "")
            self.add_line(depth, text, mark)

    def add_node(self, token: Token, text: str) -> None:
        """Adds a node of the CSG tree. Operators without comments between them share a line; their operands stand
        below, one step to the right.
        """
        depth = len(self.missing_operands) + 1
        if self.heading == "VIEW":  # the thesis's example scene has a superfluous dash here
            self.line.words.append(text)
        elif token.role not in OPERATORS.values():
            self.add_line(depth, text)
            while self.missing_operands:  # a complete run of operators is an operand of the run around it
                self.missing_operands[-1] -= 1
                if self.missing_operands[-1]:
                    break
                self.missing_operands.pop()
        elif self.line.words[-1] in OPERATORS and self.lines[-1] is self.line and not self.line.comments:
            self.line.words.append(text)
            self.missing_operands[-1] += 1
        else:
            self.add_line(depth, text)
            self.missing_operands.append(2)
