"""What the functions of a target know of the translation."""

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from ..language.diagnostics import quote
from ..language.document import Document
from ..model import Scene
from .pictures import BEGINNINGS, is_picture, located


@dataclass(frozen=True)
class Context:
    """A document on its way to Mitsuba: the options that the targets ask for, and what has been said so far.

    ``folder`` is that of the scene, where its images are; ``image_path`` makes of such an image's path what stands in
    the result.
    """

    document: Document
    folder: Path
    light_units: str
    samples: int
    allow_outside: bool
    image_path: Callable[[Path], str]
    said: set[str] = field(default_factory=set)

    @property
    def scene(self) -> Scene:
        """The scene itself."""
        return self.document.scene

    def approximate(self, reason: str, *path: str | int) -> None:
        """Says once, by a SceneWarning, what could not be said exactly."""
        if reason not in self.said:
            self.said.add(reason)
            self.document.warn(reason, *path)

    def image(self, name: str, *path: str | int) -> str:
        """What stands in the result for an image file, which has to lie in the scene's folder or below."""
        error = self.document.error
        if not name:
            raise error("this file name is empty; expected an image file", *path)
        try:
            full = Path(os.path.realpath(located(self.folder, name)))  # links may lead in a circle
            exists = full.is_file()
        except (OSError, ValueError) as reason:  # too long, or characters that no file name can have
            raise error(
                f"the image {quote(name)} cannot be a file: {getattr(reason, 'strerror', None) or reason}", *path
            ) from None
        if not self.allow_outside and not full.is_relative_to(self.folder.resolve()):
            raise error(
                f"the image {quote(name)} lies outside the scene's folder; expected a path in it, or the option that "
                "allows others: --allow-outside, allow_outside=True in Python",
                *path,
            )
        if not exists:
            marks = "; a file's name stands in double quotes, or in none" if name[0] == "'" else ""
            raise error(f"the image {quote(name)} does not exist in the scene's folder{marks}", *path)
        try:
            picture = is_picture(full)
        except OSError as reason:
            raise error(f"the image {quote(name)} cannot be read: {reason.strerror or reason}", *path) from None
        if not picture:
            raise error(f"{quote(name)} is no image; expected one of {', '.join(BEGINNINGS)} or TGA", *path)
        try:
            return self.image_path(full)
        except ValueError as reason:
            raise error(str(reason), *path) from None
