"""The images of a scene in the thesis's language, whether Mitsuba can read them to their ends.

The translator looks at their first bytes alone. A file that is still being written, or whose writing was cut short,
has those; only who reads all of it can tell.
"""

from __future__ import annotations

import re
from pathlib import Path

import mitsuba as mi
from prosim_scene.language.document import Document
from prosim_scene.language.messages import quote
from prosim_scene.targets.pictures import images, located

from .session import message

#: How Mitsuba says that a file ends too early, in most formats.
SHORT = re.compile(r"read (\d+) out of (\d+) bytes")


def check_images(document: Document) -> None:
    """Raises the :class:`prosim_scene.SceneError` of the first image that can't be read, at its place in the scene, if
    there is one. To be called when Mitsuba has failed: what it has read it would read again.
    """
    folder = Path(document.source.filename).parent
    for name, way in images(document):
        try:
            mi.Bitmap(str(located(folder, name)))
        except RuntimeError as error:
            words = message(error)
            short = SHORT.search(words)
            why = f"it ends after {short[1]} of {short[2]} bytes that are to follow" if short else words
            raise document.error(
                f"the image {quote(name)} is not whole, or damaged: {why}; save it again", *way
            ) from None
