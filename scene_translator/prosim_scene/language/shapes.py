"""Statements that differ in nothing but their numbers: one of them is parsed, the others are filled in.

Large scenes are written by programs, and nearly all of them is SURFACE and TRANSFORM in a few *shapes*: what is left of
a statement without its numbers. Words, marks and remarks are what they are whichever numbers stand between them. So a
shape is parsed once, and tells which number goes where. What is not as usual, and all that is wrong, is left to
``units.read``.
"""

import re
from typing import Any, NamedTuple

from lark import Token

from ..model import Step, Surface, Transform
from .checks import wrong
from .definitions import Definitions
from .messages import Source
from .quantities import Numbers
from .units import Unit, read
from .words import STATEMENTS, row, spelled

INDEXED = re.compile(spelled("SURFACE", "TRANSFORM"), re.IGNORECASE | re.ASCII)
#: Where the next statement begins, if that is not in a remark.
NEXT = re.compile(rf"\s(?=[a-z])({spelled(*STATEMENTS)})", re.IGNORECASE | re.ASCII)
#: What may be a number, between spaces and marks; elsewhere it is a part of a word.
NUMBERS = re.compile(r'(?<=[\s():=])([-+.0-9][-+.0-9eE]*)(?![^\s()#":=])')
#: Longer statements are not looked at, and more shapes not kept at once.
LONGEST, MOST = 2000, 1000
PLAIN = vars(Surface())


class Shape(NamedTuple):
    """SURFACE or TRANSFORM without its numbers.

    ``kind`` and ``opening``: the role of its keyword, and how long that is; ``table``: the field of a Scene that it
    stands in; ``which``: that of its numbers that is the index; ``fixed``: what it says whatever the numbers are;
    ``slots``: the names of its parameters, or the kinds of its steps, what they take, and from which to before which
    number they have it.
    """

    kind: str
    opening: int
    table: str
    which: int
    fixed: dict[str, Any]
    slots: list[tuple[str, Numbers, int, int]]

    def filled(self, numbers: list[str]) -> tuple[int, Surface | Transform] | None:
        """The statement with these numbers, by its index; None where one of them is not allowed."""
        index = numbers[self.which]
        if not index.isdigit() or len(index) > 9:
            return None
        said = []
        for name, takes, first, last in self.slots:
            try:
                value = takes.value([float(number) for number in numbers[first:last]])
            except ValueError:
                return None  # such as 1-2
            if value is None:
                return None
            said.append((name, value))
        if self.kind == "TRANSFORM":
            steps = [Step(name, value if isinstance(value, tuple) else (value,)) for name, value in said]
            return int(index), Transform(tuple(steps))
        surface = Surface(**self.fixed, **dict(said))
        return None if wrong(surface) else (int(index), surface)


class Shapes:
    """The shapes that have been met, and of those that were met again, how they are filled in, if they can be."""

    def __init__(self) -> None:
        self.met: set[tuple[str, ...]] = set()
        self.known: dict[tuple[str, ...], Shape | None] = {}

    def read(self, source: Source, start: int) -> Unit | None:
        """The statement that begins at ``start``, if it is right and can be filled in."""
        if not INDEXED.match(source.text, start):
            return None
        following = NEXT.search(source.text, start, start + LONGEST)
        if following is None or following.end() == start + LONGEST:
            return None
        text = source.text[start : following.start(1)]
        pieces = NUMBERS.split(text)
        shape = self.shape(tuple(pieces[::2]))
        filled = shape and shape.filled(pieces[1::2])
        if shape is None or filled is None:
            return None
        index, made = filled
        fields = {shape.table: {index: made}}
        return Unit(start, following.start(1), shape.kind, shape.opening, (shape.table, index), fields, text=text)

    def shape(self, pieces: tuple[str, ...]) -> Shape | None:
        """The shape of what has numbers between these pieces, if it can be filled in and is met again."""
        if (shape := self.known.get(pieces)) is not None or pieces in self.known:
            return shape
        if pieces not in self.met:
            if len(self.met) == MOST:
                self.met.clear()
                self.known.clear()
            self.met.add(pieces)
            return None
        self.known[pieces] = found = _shape(pieces, "1") or _shape(pieces, ".5")  # kd and ks may not be 1 both
        return found


def _shape(pieces: tuple[str, ...], number: str) -> Shape | None:
    """The shape of a statement of these pieces that is right with 1 as its index and ``number`` between the others."""
    text, starts = pieces[0], []
    for i, piece in enumerate(pieces[1:]):
        starts.append(len(text))
        text += (number if i else "1") + piece
    if any(mark in text for mark in '"{$') or "#" in text[text.rfind("\n") + 1 :]:
        return None  # there is more to it than words and numbers, or what seemed to follow it is in a remark
    source = Source(text, "")
    unit = read(source, 0, Definitions(source))
    if unit.end != len(text) or unit.said or unit.path is None:
        return None
    groups: list[tuple[Token, list[int]]] = []  # the keywords, and which numbers follow each of them
    for token in unit.tokens:
        if token.type == "NUMBER":
            if token.start_pos not in starts:
                return None
            groups[-1][1].append(starts.index(token.start_pos))
        elif token.type not in ("REMARK", "LPAR", "RPAR"):
            groups.append((token, []))
    (keyword, (index,)), *others = [(token, which) for token, which in groups if which]
    slots = []
    for token, which in others:
        takes = row(token).takes
        assert isinstance(takes, Numbers)
        slots.append((row(token).name, takes, which[0], which[-1] + 1))
        if which[-1] + 1 - which[0] != len(which):
            return None  # a remark with numbers stands between them
    table = str(unit.path[0])
    (made,) = unit.fields[table].values()
    given = {name for name, *_ in slots}
    fixed = {name: value for name, value in vars(made).items() if name not in given and value != PLAIN.get(name, value)}
    return Shape(keyword.type, len(keyword), table, index, fixed, slots)
