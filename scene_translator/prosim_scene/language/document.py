"""A scene, and the span of each of its values in the text."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ..model import Leaf, Operator, Scene
from .diagnostics import SceneError, SceneWarning, Source, Span

#: The path to a value of the model: ("view", "eye"), ("surfaces", 3), ("csg", 5, "textures", 0), ...
Path = tuple[str | int, ...]


@dataclass(frozen=True)
class Document:
    """A scene, its ``source`` text, the ``spans`` of its values by their paths, and the ``$names`` that it ``uses``."""

    source: Source
    spans: Mapping[Path, Span]
    scene: Scene
    uses: frozenset[str] = frozenset()

    def is_given(self, *path: str | int) -> bool:
        """Whether the text states this value of the model; otherwise it is a default."""
        return path in self.spans

    def span(self, *path: str | int) -> Span:
        """The span of a value in the text, or else of the value around it, or else the beginning of the text."""
        while path and path not in self.spans:
            path = path[:-1]
        return self.spans.get(path) or Span(0, 0)

    def text_of(self, *path: str | int) -> str:
        """The words of the text that state a value."""
        return self.source.text[slice(*self.span(*path))]

    def line(self, *path: str | int) -> int:
        """The line, from 1, on which the text states a value."""
        return self.source.line(self.span(*path))

    def error(self, reason: str, *path: str | int, code: str = "") -> SceneError:
        """The error to raise about a value; its code is by default the first part of the path."""
        return self.source.error(self.span(*path), reason, code or str(path[0]))

    def warning(self, reason: str, *path: str | int, code: str = "") -> SceneWarning:
        """The warning to emit about a value; its code is by default the first part of the path."""
        return self.source.warning(self.span(*path), reason, code or str(path[0]))

    def warn(self, reason: str, *path: str | int) -> None:
        """Emits a :class:`SceneWarning` about a value."""
        warnings.warn(self.warning(reason, *path), stacklevel=2)

    def operands_note(self, number: int) -> str:
        """A note with the operands of the nearest operator - or * above a node of the tree, or an empty string.

        For messages about solids that vanish, often because an operator is between its operands.
        """
        ends = subtree_ends(self.scene.csg)
        above = [i for i in range(number) if ends[i] > number and self.text_of("csg", i) in ("-", "*")]
        if not above:
            return ""
        first, second = above[-1] + 1, ends[above[-1] + 1]
        words = [self.text_of("csg", i) + f" (line {self.line('csg', i)})" for i in (above[-1], first, second)]
        return f"; operators come before their operands: {words[0]} has the operands {words[1]} and {words[2]}"


def subtree_ends(csg: Sequence[Operator | Leaf]) -> list[int]:
    """The index after each subtree; beyond the end of ``csg`` where operands are missing."""
    ends = list(range(1, 2 * len(csg) + 2))
    for i in reversed(range(len(csg))):
        if isinstance(csg[i], Operator):
            ends[i] = ends[ends[i + 1]]
    return ends[: len(csg)]
