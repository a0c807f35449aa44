"""A scene, and beside it where each of its values stands in the text."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass

from ..model import Scene
from .messages import Place, Said, SceneError, Source

#: The way to a value of the model: ("view", "eye"), ("surfaces", 3), ("csg", 5, "textures", 0), ...
Path = tuple[str | int, ...]


@dataclass(frozen=True)
class Places:
    """A text, and the places of the values in it by their paths in the model."""

    source: Source
    places: Mapping[Path, Place]

    def given(self, *path: str | int) -> bool:
        """Whether the text gives this value, or it is a default."""
        return path in self.places

    def place(self, *path: str | int) -> Place:
        """Where a value stands, or else what it belongs to; the beginning of the text if that is not given either."""
        while path and path not in self.places:
            path = path[:-1]
        return self.places.get(path) or Place(0, 0)

    def word(self, *path: str | int) -> str:
        """What the text has at the place of a value."""
        place = self.place(*path)
        return self.source.text[place.start : place.end]

    def line(self, *path: str | int) -> int:
        """The line of a value, from 1."""
        return self.source.line(self.place(*path))

    def error(self, reason: str, *path: str | int) -> SceneError:
        """The error to raise about a value."""
        return self.source.error(self.place(*path), reason)

    def said(self, reason: str, *path: str | int, error: bool = False) -> Said:
        """What an error or a warning is to say about a value."""
        return self.source.said(self.place(*path), reason, error)


@dataclass(frozen=True)
class Document(Places):
    """A scene with its text and the places of its values, and the ``$names`` that it uses."""

    scene: Scene
    uses: frozenset[str] = frozenset()

    def warn(self, reason: str, *path: str | int) -> None:
        """Emits a :class:`SceneWarning` about a value."""
        warnings.warn(self.source.warning(self.place(*path), reason), stacklevel=2)
