"""A scene by its content: its text, and that of every file which it names."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path

import mitsuba as mi

from .xml_reading import UnreadableError, named

COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)


def digest(state: mi.parser.ParserState, definitions: Mapping[str, str], begin: mi.FileResolver) -> str:
    """SHA-256 of a scene as it was parsed: of its files without their comments, in which what names another file stands
    for that one's content, wherever it lies; and of those that it names by parameters, such as ``wood.$frame.png``.
    ``definitions``: values of its parameters; ``begin``: the search path with which parsing began. To be called where
    it is what parsing has left.
    """
    result = hashlib.sha256()
    files = named_files(state, definitions, begin)
    contents = {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files}
    texts = [COMMENT.sub(b"", Path(str(path)).read_bytes()) for path in state.files]
    said = {name for name in contents if any(os.fsencode(name) in text for text in texts)}
    for text in texts:
        for name in sorted(said, key=len, reverse=True):  # none within another
            text = text.replace(os.fsencode(name), contents[name].encode())
        result.update(text + b"\0")
    for name, content in contents.items():
        if name not in said:
            result.update(content.encode())
    return result.hexdigest()


def named_files(
    state: mi.parser.ParserState, definitions: Mapping[str, str], begin: mi.FileResolver
) -> Iterator[tuple[str, Path]]:
    """Those of the strings in a scene that name a file which is there, and the file; see :func:`digest`."""
    resolver = mi.file_resolver()
    values = [value for node in state.nodes for value in dict(node.props.items()).values()]
    for value in values:
        if isinstance(value, str) and value:
            path = Path(str(resolver.resolve(value)))
            if path.is_file():
                yield value, path
    # The files of spectra Mitsuba's parser reads itself, and tells of their numbers.
    with suppress(UnreadableError):  # it forgives more
        for element in named(str(state.files[0]), definitions, begin):
            if element.tag == "spectrum" and element.path.is_file():
                yield element.name, element.path
