"""Adds details to Mitsuba's error messages: the line of the XML file, the name of a similar plugin, or the damaged
image.
"""

from __future__ import annotations

import difflib
from pathlib import Path

import mitsuba as mi
import prosim_scene

from .. import registry
from ..compat import LIBRARIES, NOT_FOUND, PLACE, TAGS
from .session import message


def with_line(words: str, scene: Path | None = None) -> str:
    """Returns an error message, followed by the line of the XML file to which the message refers, and a caret (^) below
    the column of the error. If no line can be shown, returns the message alone.

    ``words`` is the error message. If the message contains several positions (file, line and column), the last position
    whose line can be shown is used, because Mitsuba names an included file after the file that includes it. If
    ``scene`` is the path of a scene file, only lines of this file and of files in its folder and subfolders are shown.
    If lines of other files were shown, an untrusted scene could reveal any file, because the scene can put the name of
    any file into the error message.
    """
    for place in reversed(list(PLACE.finditer(words))):
        path = Path(place[1])
        known = scene is None or path == scene or path.resolve().is_relative_to(scene.parent.resolve())
        if known and (line := _line(path, int(place[2]), int(place[3]))):
            return f"{words.rstrip()}\n{line}"
    return words.rstrip()


def _line(path: Path, line: int, column: int) -> str:
    """Returns a line of an XML file, with a caret below ``column``; an empty text if there is none."""
    if path.suffix != ".xml":
        return ""
    try:
        source = prosim_scene.Source(path.read_text(encoding="utf-8"), str(path))
        start = source.line_starts[line - 1] + max(column - 1, 0)
    except (OSError, ValueError, IndexError):
        return ""
    # The first line of the message, which has only the position, is left out.
    return source.message(prosim_scene.Span(start, start + 1), "").partition("\n")[2]


def with_suggestion(words: str) -> str:
    """Returns an error message, with the name of a similar plugin added if the message says that a plugin does not
    exist, and if there is a similar plugin.

    ``words`` is the error message. The suggested plugin has the same kind as the missing plugin; for example, both are
    BSDFs. If the message does not tell the kind of the missing plugin ("unknown"), the suggested plugin may have any
    kind.
    """
    found = NOT_FOUND.search(words)
    if found is None:
        return words
    native = [path.stem for path in Path(mi.__file__).parent.glob("plugins/*") if path.suffix in LIBRARIES]
    kind_of, kind = mi.PluginManager.instance().plugin_type, TAGS.get(found[1], found[1])
    for near in difflib.get_close_matches(found[2], {*native, *registry.PLUGINS}, n=9):
        if kind in ("unknown", kind_of(near).name.lower()):
            return f"{words[: found.end()]} Did you mean {near}?{words[found.end() :]}"
    return words


def check_images(document: prosim_scene.Document) -> None:
    """Reads all image files of a scene with Mitsuba; raises :class:`prosim_scene.SceneError` for the first image that
    Mitsuba cannot read.

    The error message tells where the scene's text names the damaged image. This check is needed, because the translator
    of the scene language checks only the first bytes of an image file.
    """
    folder = Path(document.source.filename).parent
    for name, way in prosim_scene.images(document):  # ``way``: where the scene's text names the image
        try:
            mi.Bitmap(str(prosim_scene.located(folder, name)))
        except RuntimeError as error:
            why = f"the image {name!r} is incomplete or damaged: {message(error)}; save it again"
            raise document.error(why, *way) from None
