"""A scene by its content: its text, and that of every file which it names."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from xml.etree import ElementTree

import mitsuba as mi

COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)


def digest(state: mi.parser.ParserState, definitions: Mapping[str, str]) -> str:
    """SHA-256 of a scene as it was parsed: of its files without their comments, in which what names another file stands
    for that one's content, wherever it lies; and of those that it names by parameters, such as ``wood.$frame.png``.
    ``definitions``: values of its parameters. To be called where the search paths are those of the parser.
    """
    result = hashlib.sha256()
    contents = {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in named_files(state, definitions)}
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


def named_files(state: mi.parser.ParserState, definitions: Mapping[str, str]) -> Iterator[tuple[str, Path]]:
    """Those of the strings in a scene that name a file which is there, and the file."""
    resolver = mi.file_resolver()
    values = [value for node in state.nodes for value in dict(node.props.items()).values()]
    for value in [*values, *spectra(state, definitions)]:
        if isinstance(value, str) and value:
            path = Path(str(resolver.resolve(value)))
            if path.is_file():
                yield value, path


def spectra(state: mi.parser.ParserState, definitions: Mapping[str, str]) -> Iterator[str]:
    """Names of the files of spectra, as the text has them: Mitsuba's parser reads these, and tells of their numbers."""
    elements: list[ElementTree.Element] = []
    for path in state.files:
        with suppress(ElementTree.ParseError):  # Mitsuba's parser forgives more
            elements += ElementTree.parse(str(path)).iter()
    values = {element.get("name", ""): element.get("value", "") for element in elements if element.tag == "default"}
    values.update(definitions)
    for element in elements:
        if element.tag == "spectrum" and (name := element.get("filename")):
            yield re.sub(r"\$(\w+)", lambda found: values.get(found[1], found[0]), name)
