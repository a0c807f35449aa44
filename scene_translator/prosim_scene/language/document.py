"""A scene, and beside it where each of its values stands in the text."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass

from ..model import Leaf, Scene
from .diagnostics import Diagnostic, SceneError, Source, Span

#: The path to a value of the model: ("view", "eye"), ("surfaces", 3), ("csg", 5, "textures", 0), ...
Path = tuple[str | int, ...]


@dataclass(frozen=True)
class Document:
    """A scene, its ``source`` text, the ``spans`` of its values by their paths, and the ``$names`` that it ``uses``."""

    source: Source
    spans: Mapping[Path, Span]
    scene: Scene
    uses: frozenset[str] = frozenset()

    def given(self, *path: str | int) -> bool:
        """Whether the text gives this value, or it is a default."""
        return path in self.spans

    def span(self, *path: str | int) -> Span:
        """Where a value stands, or else what it belongs to; the beginning of the text if that is not given either."""
        while path and path not in self.spans:
            path = path[:-1]
        return self.spans.get(path) or Span(0, 0)

    def word(self, *path: str | int) -> str:
        """What the text has at the place of a value."""
        span = self.span(*path)
        return self.source.text[span.start : span.end]

    def line(self, *path: str | int) -> int:
        """The line of a value, from 1."""
        return self.source.line(self.span(*path))

    def error(self, reason: str, *path: str | int) -> SceneError:
        """The error to raise about a value; its code is the first part of the path."""
        return self.source.error(self.span(*path), reason, str(path[0]))

    def warn(self, reason: str, *path: str | int) -> None:
        """Emits a :class:`SceneWarning` about a value; its code is the first part of the path."""
        warnings.warn(self.source.warning(self.span(*path), reason, str(path[0])), stacklevel=2)

    def diagnostic(self, reason: str, code: str, *path: str | int, error: bool = False) -> Diagnostic:
        """The diagnostic of a value."""
        return self.source.diagnostic(self.span(*path), reason, code, error)

    def operation(self, number: int) -> str:
        """Which operands the operator - or * nearest above a node of the tree has, in words; nothing if there is none.

        For messages about solids that vanish, often because operators were written between their operands.
        """
        csg = self.scene.csg
        ends = [0] * len(csg)  # behind each subtree
        for i in reversed(range(len(csg))):
            ends[i] = i + 1 if isinstance(csg[i], Leaf) else ends[ends[i + 1]]
        above = [i for i in range(number) if ends[i] > number and self.word("csg", i) in ("-", "*")]
        if not above:
            return ""
        first, second = above[-1] + 1, ends[above[-1] + 1]
        words = [self.word("csg", i) + f" (line {self.line('csg', i)})" for i in (above[-1], first, second)]
        return f"; operators come before their operands: {words[0]} has the operands {words[1]} and {words[2]}"
