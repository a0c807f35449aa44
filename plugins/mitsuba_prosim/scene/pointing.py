"""The place in an XML file that an error of Mitsuba speaks of, shown as the translator shows those of a scene."""

from __future__ import annotations

import os
import re
from pathlib import Path

from prosim_scene.language.messages import Place, Source

#: How Mitsuba names a place: ``While loading FILE (line 3, col 6)``, ``At FILE (...)``, or ``Parsing of XML file "FILE"
#: failed: ... (...)``.
NAMED = re.compile(r'(?:[Ll]oading|XML file|At) "?([^"\n]+?)"?(?: failed: [^\n]*?)? \(line (\d+), col (\d+)\)')


def pointed(words: str, scene: Path | None = None) -> str:
    """``words``, and the line that they speak of with a caret below it, where it can be read: of several the last, as
    that of a file which is included is named after what includes it. ``scene``: a file, lines of which may be shown,
    and of what lies in its folder or below, but of no other file, as words may be the scene's own.
    """
    places = [
        place
        for place in NAMED.finditer(words)
        if scene is None
        or Path(place[1]) == scene
        or Path(os.path.realpath(place[1])).is_relative_to(os.path.realpath(scene.parent))
    ]
    lines = (_line(found[1], int(found[2]), int(found[3])) for found in reversed(places))
    return "\n".join([words.rstrip(), *[line for line in lines if line][:1]])


def files(words: str) -> list[str]:
    """Names of the files in which ``words`` name a place."""
    return [found[1] for found in NAMED.finditer(words)]


def _line(name: str, line: int, column: int) -> str:
    """A line of a file, and the caret below; nothing where that is no XML file which can be read."""
    if not name.endswith(".xml"):
        return ""
    try:
        source = Source(Path(name).read_text(encoding="utf-8"), name)
    except (OSError, ValueError):
        return ""
    if not 0 < line <= len(source.line_starts):
        return ""
    start = source.line_starts[line - 1] + max(column - 1, 0)
    return source.message(Place(start, start + 1), "").partition("\n")[2]
