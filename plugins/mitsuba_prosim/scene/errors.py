"""Improves messages of Mitsuba's errors: shows the line of an XML file, a similar plugin, or the damaged image."""

from __future__ import annotations

import difflib
from pathlib import Path

import mitsuba as mi
from prosim_scene import Document, Source, Span, images, located

from .. import registry
from ..compat import LIBRARIES, NOT_FOUND, PLACE, TAGS
from .session import message


def with_line(words: str, scene: Path | None = None) -> str:
    """Returns a message with the line of the XML file that the message names, and a caret below the column.

    ``words`` is the message. If the message names several places, the last place is shown, because an included file is
    named after the file that includes it. With ``scene``, only lines of this file and of files in its folder are shown:
    an untrusted scene can put the name of any file into the message, and must not make other files visible.
    """
    for place in reversed(list(PLACE.finditer(words))):
        path = Path(place[1])
        known = scene is None or path == scene or path.resolve().is_relative_to(scene.parent.resolve())
        if known and (line := _line(path, int(place[2]), int(place[3]))):
            return f"{words.rstrip()}\n{line}"
    return words.rstrip()


def _line(path: Path, line: int, column: int) -> str:
    """Returns a line of an XML file and the caret below it; an empty text if the file cannot be read."""
    if path.suffix != ".xml":
        return ""
    try:
        source = Source(path.read_text(encoding="utf-8"), str(path))
        start = source.line_starts[line - 1] + max(column - 1, 0)
    except (OSError, ValueError, IndexError):
        return ""
    return source.message(Span(start, start + 1), "").partition("\n")[2]


def with_suggestion(words: str) -> str:
    """Returns a message; if the message says that a plugin does not exist, with the name of a similar plugin.

    ``words`` is the message. The similar plugin is of the same kind, a BSDF for example.
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


def check_images(document: Document) -> None:
    """Raises :class:`prosim_scene.SceneError` for the first image of a scene that Mitsuba cannot read.

    The error names the place of the image in the scene's text. The translator checks only the first bytes of an image.
    """
    folder = Path(document.source.filename).parent
    for name, way in images(document):
        try:
            mi.Bitmap(str(located(folder, name)))
        except RuntimeError as error:
            why = f"the image {name!r} is incomplete or damaged: {message(error)}; save it again"
            raise document.error(why, *way) from None
