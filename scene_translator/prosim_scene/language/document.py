"""Defines a document, which is a scene together with the position (span) of each of its values in the text."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

from ..model import Leaf, Operator, Scene
from .diagnostics import SceneError, SceneWarning, Source, Span
from .words import OPERATORS, WORDS_BY_SPELLING, normalise

#: The path of a value in the model: ("view", "eye"), ("surfaces", 3), ("csg", 5, "textures", 0), ...
Path = tuple[str | int, ...]
#: Matches a character between the words of a text.
SEPARATOR = re.compile(r'[\s()#":=]')


@dataclass(frozen=True)
class Document:
    """A ``scene``, its ``source`` text, and ``spans``, a dictionary from the path of each value, such as ("view",
    "eye"), to the position of the value in the text.

    ``uses`` is the set of the ``$names`` that the text uses.
    """

    source: Source
    spans: Mapping[Path, Span]
    scene: Scene
    uses: frozenset[str] = frozenset()

    def is_given(self, *path: str | int) -> bool:
        """Whether the text states the value with the path ``path``, such as ("view", "eye")."""
        return path in self.spans

    def span(self, *path: str | int) -> Span:
        """Returns the span of a value in the text; if the text does not state it, the span of the enclosing value, or
        the beginning of the text.
        """
        while path and path not in self.spans:
            path = path[:-1]
        return self.spans.get(path) or Span(0, 0)

    def text_of(self, *path: str | int) -> str:
        """Returns the part of the text that states a value."""
        return self.source.text[slice(*self.span(*path))]

    def line(self, *path: str | int) -> int:
        """Returns the number of the line on which the text states a value."""
        return self.source.line_column(self.span(*path).start)[0]

    def error(self, reason: str, *path: str | int, code: str = "") -> SceneError:
        """Returns an error about a value; the default of ``code`` is the first part of the value's path."""
        return self.source.error(self.span(*path), reason, code or str(path[0]))

    def warning(self, reason: str, *path: str | int, code: str = "") -> SceneWarning:
        """Returns a warning about a value; the default of ``code`` is the first part of the value's path."""
        return self.source.diagnostic(SceneWarning, self.span(*path), reason, code or str(path[0]))

    def warn(self, reason: str, *path: str | int) -> None:
        """Emits a :class:`SceneWarning` about a value."""
        self.warning(reason, *path).emit()

    def names_of(self, leaves: Sequence[int]) -> str:
        """Returns the names and lines of these leaves of the CSG tree; of more than ten names, the first ten."""
        numbers = [self.scene.leaves[i][0] for i in leaves]
        names = [*dict.fromkeys(f"{self.name_of(number)} (line {self.line('csg', number)})" for number in numbers)]
        return ", ".join(names[:10]) + (f" and {len(names) - 10} more" if len(names) > 10 else "")

    def name_of(self, number: int, whole: bool = False) -> str:
        """Returns the name of node ``number`` of the CSG tree: an operator, a primitive, or a primitive in the use of a
        named solid; ``whole``: only the use.
        """
        node, text = cast(Any, self.scene.csg[number]), self.text_of("csg", number)
        if text in OPERATORS:
            return text
        first, *_, last = SEPARATOR.split(text)
        if normalise(first) in WORDS_BY_SPELLING:  # not the name of a solid
            return f"{node.shape.upper()} {node.index}"
        use = f"{first} {text[text.rindex('{') :] if last.endswith('}') else last}"  # without comments before the index
        return use if whole else f"a {node.shape.upper()} in {use}"

    def surface_name(self, index: int) -> str:
        """Returns the name of a SURFACE in the text, where primitives of named solids have that of their solid."""
        return f"SURFACE {self.first_surfaces[self.spans.get(('surfaces', index))]}"

    @cached_property
    def first_surfaces(self) -> dict[Span | None, int]:
        """A dictionary from each place of a SURFACE in the text to the lowest of the indices that it has."""
        return {self.spans.get(("surfaces", i)): i for i in sorted(self.scene.surfaces, reverse=True)}

    def operands_note(self, number: int) -> str:
        """Returns a note on the operands of the nearest - or * above a node, or "": users often write an operator
        between its operands by mistake, and solids vanish.
        """
        ends = subtree_ends(self.scene.csg)
        above = [i for i in range(number) if ends[i] > number and self.text_of("csg", i) in ("-", "*")]
        if not above:
            return ""
        first, second = above[-1] + 1, ends[above[-1] + 1]
        words = [self.name_of(i, whole=True) + f" (line {self.line('csg', i)})" for i in (above[-1], first, second)]
        return f"; operators come before their operands: {words[0]} has the operands {words[1]} and {words[2]}"


def subtree_ends(csg: Sequence[Operator | Leaf]) -> list[int]:
    """Returns the position after each node's subtree in prefix order; beyond the end if operands are missing."""
    ends = list(range(1, 2 * len(csg) + 2))  # each position, also beyond the end of csg, counts as a leaf at first
    for i in reversed(range(len(csg))):
        if isinstance(csg[i], Operator):
            ends[i] = ends[ends[i + 1]]  # the second operand begins where the first operand ends
    return ends[: len(csg)]
