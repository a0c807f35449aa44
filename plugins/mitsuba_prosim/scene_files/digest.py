"""A scene by its content: its text, and that of every file which it names."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from pathlib import Path

import mitsuba as mi

COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)


def digest(state: mi.parser.ParserState) -> str:
    """SHA-256 of a scene as it was parsed: of its files without their comments, in which what names another file stands
    for that one's content, wherever it lies. To be called where the search paths are those of the parser.
    """
    result = hashlib.sha256()
    contents = {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in named_files(state)}
    for path in state.files:
        text = COMMENT.sub(b"", Path(str(path)).read_bytes())
        for name in sorted(contents, key=len, reverse=True):  # none within another
            text = text.replace(name.encode(), contents[name].encode())
        result.update(text + b"\0")
    return result.hexdigest()


def named_files(state: mi.parser.ParserState) -> Iterator[tuple[str, Path]]:
    """Those of the strings in a scene that name a file which is there, and the file."""
    resolver = mi.file_resolver()
    for node in state.nodes:
        for value in dict(node.props.items()).values():
            if isinstance(value, str) and value:
                path = Path(str(resolver.resolve(value)))
                if path.is_file():
                    yield value, path
