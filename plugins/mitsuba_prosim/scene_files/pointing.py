"""The place in an XML file that an error of Mitsuba speaks of, shown as the translator shows those of a scene."""

from __future__ import annotations

import re
from pathlib import Path

from prosim_scene.language.messages import Place, Source

#: How Mitsuba names a place: ``While loading FILE (line 3, col 6)``, ``At FILE (...)``, or ``Parsing of XML file "FILE"
#: failed: ... (...)``.
NAMED = re.compile(r'(?:[Ll]oading|XML file|At) "?([^"\n]+?)"?(?: failed: [^\n]*?)? \(line (\d+), col (\d+)\)')


def pointed(words: str) -> str:
    """``words``, and the first line that they speak of with a caret below it, where it can be read."""
    found = NAMED.search(words)
    if found is None or not found[1].endswith(".xml"):
        return words
    try:
        source = Source(Path(found[1]).read_text(encoding="utf-8"), found[1])
    except (OSError, ValueError):
        return words
    line, column = int(found[2]), int(found[3])
    if not 0 < line <= len(source.line_starts):
        return words
    start = source.line_starts[line - 1] + max(column - 1, 0)
    return f"{words.rstrip()}\n{source.message(Place(start, start + 1), '').partition(chr(10))[2]}"
