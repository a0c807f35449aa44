"""The files that Mitsuba's parser opens while it reads an XML scene: includes and spectra."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

import mitsuba as mi

#: Element -> its attribute that names a file or a folder.
ATTRIBUTES = {"include": "filename", "spectrum": "filename", "path": "value"}


class Reference(NamedTuple):
    """A file that an element names. ``tag``: one of :data:`ATTRIBUTES`; ``text``: the name with its parameters;
    ``path``: where Mitsuba finds it; ``place``: of the element, in the form of Mitsuba's messages.
    """

    tag: str
    text: str
    path: Path
    place: str


class UnreadableError(ValueError):
    """An XML text that parsers may read differently."""


def references(path: str | Path, definitions: Mapping[str, str], resolver: mi.FileResolver) -> Iterator[Reference]:
    """The references of an XML scene and of its includes, in the order of Mitsuba's parser.

    ``definitions``: values of parameters; ``resolver``: the search path before parsing, which stays unchanged. Where a
    value contains other parameters, Mitsuba may find another file. An included file is read when the next reference is
    requested. Raises UnreadableError and OSError.
    """
    return _references(str(path), dict(definitions), mi.FileResolver(resolver), ())


def _references(
    file: str, definitions: dict[str, str], resolver: mi.FileResolver, around: tuple[str, ...]
) -> Iterator[Reference]:
    folder = os.path.dirname(file)
    for tag, attributes, place in elements(file):
        if tag == "default":
            definitions.setdefault(attributes.get("name", ""), attributes.get("value", ""))
        text = attributes.get(ATTRIBUTES.get(tag, ""))
        if not text:
            continue
        search = mi.FileResolver(resolver)
        if tag != "spectrum" and folder:
            search.prepend(folder)
        found = str(search.resolve(re.sub(r"\$(\w+)", lambda name: definitions.get(name[1], name[0]), text)))
        yield Reference(tag, text, Path(found), place)
        if tag == "path":
            resolver.prepend(found)
        elif tag == "include" and os.path.isfile(found):
            if found in around:
                raise UnreadableError(f"At {place}: the file includes itself")
            yield from _references(found, definitions, search, (*around, found))


def elements(file: str | Path) -> list[tuple[str, dict[str, str], str]]:
    """Tag, attributes and place of each element of an XML file.

    Raises OSError, and UnreadableError where the text is not well-formed, or where Mitsuba's parser might read it
    differently: Mitsuba ignores document types and follows the declared encoding.
    """
    content = Path(file).read_bytes()
    found: list[tuple[str, dict[str, str], str]] = []
    parser = expat.ParserCreate("utf-8")

    def place(column: int) -> str:
        return f"(line {parser.CurrentLineNumber}, col {parser.CurrentColumnNumber + column})"

    def refuse(why: str) -> None:
        raise UnreadableError(f'Parsing of XML file "{file}" failed: {why} {place(1)}')

    def declaration(version: str, encoding: str | None, standalone: int) -> None:
        if (encoding or "utf-8").lower() not in ("utf-8", "utf8", "us-ascii") and not content.isascii():
            refuse(f"the encoding is {encoding}; save the file in UTF-8")

    def element(tag: str, attributes: dict[str, str]) -> None:
        found.append(
            (tag, attributes, f"{file} (line {parser.CurrentLineNumber}, col {parser.CurrentColumnNumber + 2})")
        )

    parser.XmlDeclHandler, parser.StartElementHandler = declaration, element
    parser.StartDoctypeDeclHandler = lambda *_: refuse("remove <!DOCTYPE>; Mitsuba ignores it")
    try:
        content.decode("utf-8")
        parser.Parse(content, True)
    except UnicodeDecodeError:
        refuse("the file is not in UTF-8; save it in UTF-8")
    except expat.ExpatError as error:
        refuse(expat.ErrorString(error.code))
    return found
