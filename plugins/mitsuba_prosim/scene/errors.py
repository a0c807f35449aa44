"""Adds details to Mitsuba's error messages: the line of the XML file, the name of a similar plugin, or the damaged
image.
"""

from __future__ import annotations

import difflib
from pathlib import Path

import mitsuba as mi
import prosim_scene

from .. import registry
from ..compat import NOT_FOUND, PLACE, TAGS, native_plugins
from .session import message


def with_line(words: str, scene: Path | None = None) -> str:
    """Returns the error message ``words``, followed by the line of the XML file to which it refers, with a caret (^)
    below the column, if the line can be shown.

    Of several positions, the last one is used, because Mitsuba names an included file after the file that includes it.
    If ``scene`` is the path of a scene file, only lines of files in its folder and below are shown: an untrusted scene
    can put the name of any file into a message, whose line would reveal this file.
    """
    for place in reversed(list(PLACE.finditer(words))):
        path = Path(place[1])
        known = scene is None or path == scene or path.resolve().is_relative_to(scene.parent.resolve())
        if known and (line := _line(path, int(place[2]), int(place[3]))):
            return f"{words.rstrip()}\n{line}"
    return words.rstrip()


def _line(path: Path, line: int, column: int) -> str:
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
    """Returns the error message ``words``, and the name of a similar plugin of the same kind if a plugin does not
    exist; without a similar integrator, the option that does without it.

    If the message does not tell the kind ("unknown"), the suggested plugin may have any kind.
    """
    found = NOT_FOUND.search(words)
    if found is None:
        return words
    kind_of, kind = mi.PluginManager.instance().plugin_type, TAGS.get(found[1], found[1])
    hint = " With --paths, prosim render, explain and watch do without it." if kind == "integrator" else ""
    for near in difflib.get_close_matches(found[2], native_plugins() | set(registry.PLUGINS), n=9):
        if kind in ("unknown", kind_of(near).name.lower()):
            hint = f" Did you mean {near}?"
            break
    return words[: found.end()] + hint + words[found.end() :]


def check_images(document: prosim_scene.Document) -> None:
    """Reads all image files of a scene; raises :class:`prosim_scene.SceneError`, with its place in the text, for the
    first image that Mitsuba cannot read.
    """
    folder = Path(document.source.filename).parent
    for name, way in prosim_scene.images(document):  # ``way``: where the scene's text names the image
        try:
            mi.Bitmap(str(prosim_scene.located(folder, name)))
        except RuntimeError as error:
            why = f"the image {name!r} is incomplete, damaged or in an unknown format: {message(error)}"
            why += "; save it again as PNG, JPEG, OpenEXR, RGBE, PFM, PPM, BMP or TGA"
            raise document.error(why, *way) from None
