"""What Mitsuba's errors speak of: the place in an XML file, the plugin that may be meant, the image that is damaged."""

from __future__ import annotations

import difflib
import os
import re
from pathlib import Path

import mitsuba as mi
from prosim_scene import Document, Source, Span, images, located

from .. import registry
from ..compat import DAMAGED, LIBRARIES, NOT_FOUND, PLACE, TAGS
from .session import message

# ---------------------------------------------------------------- the place


def pointed(words: str, scene: Path | None = None) -> str:
    """``words``, and the line that they speak of with a caret below it: of several places the last, as an included file
    is named after the one that includes it. ``scene``: only lines of this file, and of those in its folder or below,
    are shown, as ``words`` may be the scene's own.
    """
    places = [
        place
        for place in PLACE.finditer(words)
        if scene is None
        or Path(place[1]) == scene
        or Path(os.path.realpath(place[1])).is_relative_to(os.path.realpath(scene.parent))
    ]
    lines = (_line(found[1], int(found[2]), int(found[3])) for found in reversed(places))
    return "\n".join([words.rstrip(), *[line for line in lines if line][:1]])


def files(words: str) -> list[str]:
    """Names of the files in which ``words`` name a place."""
    return [found[1] for found in PLACE.finditer(words)]


def _line(name: str, line: int, column: int) -> str:
    """A line of an XML file, and the caret below; empty where it can't be read."""
    if not name.endswith(".xml"):
        return ""
    try:
        source = Source(Path(name).read_text(encoding="utf-8"), name)
    except (OSError, ValueError):
        return ""
    if not 0 < line <= len(source.line_starts):
        return ""
    start = source.line_starts[line - 1] + max(column - 1, 0)
    return source.message(Span(start, start + 1), "").partition("\n")[2]


# ---------------------------------------------------------------- the plugin


def nearest(name: str, kind: str) -> str | None:
    """The plugin of this kind, in lower case, whose name is most like ``name``; None where none is like it."""
    names = [path.stem for path in Path(mi.__file__).parent.glob("plugins/*") if path.suffix in LIBRARIES]
    near = difflib.get_close_matches(name, {*names, *registry.PLUGINS}, n=9)
    kind_of = mi.PluginManager.instance().plugin_type
    return next((one for one in near if kind_of(one).name.lower() == TAGS.get(kind, kind)), None)


def with_nearest(words: str) -> str:
    """``words``, with the name of a similar plugin where they say that there is no such plugin."""

    def meant(found: re.Match[str]) -> str:
        near = nearest(found[2], found[1])
        return found[0] + (f" Did you mean {near}?" if near else "")

    return NOT_FOUND.sub(meant, words)


# ---------------------------------------------------------------- the image


def check_images(document: Document) -> None:
    """Raises the :class:`prosim_scene.SceneError` of the first image that Mitsuba can't read, at its place in the text.

    The translator looks at the first bytes of an image only, so that one that is cut short fails in Mitsuba.
    """
    folder = Path(document.source.filename).parent
    for name, way in images(document):
        try:
            mi.Bitmap(str(located(folder, name)))
        except RuntimeError as error:
            words = message(error)
            short = DAMAGED.search(words)
            why = f"it ends after {short[1]} of {short[2]} bytes that are to follow" if short else words
            raise document.error(f"the image {name!r} is not whole, or damaged: {why}; save it again", *way) from None
