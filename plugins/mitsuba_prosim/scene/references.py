"""The files that an XML scene names in elements that Mitsuba's parser itself opens."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import mitsuba as mi

#: Element -> its attribute that names a file or a folder.
ATTRIBUTES = {"include": "filename", "spectrum": "filename", "path": "value"}


class Reference(NamedTuple):
    """A file that an element names. ``tag``: one of :data:`ATTRIBUTES`; ``name``: with parameters substituted;
    ``path``: where Mitsuba finds it; ``place``: of the element, as Mitsuba writes places.
    """

    tag: str
    name: str
    path: Path
    place: str


class UnreadableError(ValueError):
    """Readers of XML may disagree on the text."""


def references(path: str | Path, definitions: Mapping[str, str], resolver: mi.FileResolver) -> Iterator[Reference]:
    """The references of the scene at ``path`` and of the files that it includes, in the parser's order.

    ``definitions``: values of parameters; ``resolver``: search path at the beginning, which stays as it is. An included
    file is read only when the next reference is asked for. Raises UnreadableError, and OSError for a file that can't be
    read.
    """
    # `<default>` gives a value to a parameter that has none, so the first one counts.
    defaults = [(name, value.replace("$", "\\$")) for name, value in definitions.items()]
    yield from _references(str(path), defaults, mi.FileResolver(resolver), 0)


def _references(
    file: str, defaults: list[tuple[str, str]], resolver: mi.FileResolver, depth: int
) -> Iterator[Reference]:
    beside = os.path.dirname(file)
    for tag, attributes, place in elements(file):
        if tag == "default":
            defaults.append((attributes.get("name", ""), attributes.get("value", "")))
        name = attributes.get(ATTRIBUTES.get(tag, ""))
        if not name:
            continue
        try:
            name = substituted(name, defaults)
        except RuntimeError:
            raise UnreadableError(f"Error while loading {place}: a parameter of {name!r} has no value") from None
        if tag == "spectrum":
            yield Reference(tag, name, Path(str(resolver.resolve(name))), place)
        elif tag == "path":
            folder = os.path.join(beside, name)
            if not os.path.exists(folder):
                folder = str(resolver.resolve(name))
            yield Reference(tag, name, Path(folder), place)
            resolver.prepend(folder)
        else:
            within = mi.FileResolver(resolver)
            if beside:
                within.prepend(beside)
            included = str(within.resolve(name))
            yield Reference(tag, name, Path(included), place)
            if not os.path.isfile(included):
                return
            if depth + 1 >= mi.parser.ParserConfig("").max_include_depth:
                raise UnreadableError(f"At {place}: files include each other more deeply than Mitsuba follows them")
            yield from _references(included, defaults, within, depth + 1)


def substituted(text: str, defaults: list[tuple[str, str]]) -> str:
    """``text`` with the values of parameters, as Mitsuba's parser substitutes them. Raises RuntimeError."""
    if "$" not in text:
        return text
    given = "".join(f"<default name={quoteattr(name)} value={quoteattr(value)}/>" for name, value in defaults)
    scene = f'<scene version="3.0.0">{given}<string name="text" value={quoteattr(text)}/></scene>'
    return str(mi.parser.parse_string(mi.parser.ParserConfig(""), scene).root.props["text"])


def elements(file: str | Path) -> list[tuple[str, dict[str, str], str]]:
    """Tag, attributes and place of each element of an XML file.

    Raises OSError, and UnreadableError where the text is not well-formed, or where Mitsuba's parser, which ignores
    document types and some encodings, might read something else.
    """
    content = Path(file).read_bytes()
    found: list[tuple[str, dict[str, str], str]] = []
    parser = expat.ParserCreate("utf-8")

    def rejected(words: str, line: int = 1, column: int = 1) -> UnreadableError:
        return UnreadableError(f'Parsing of XML file "{file}" failed: {words} (line {line}, col {column})')

    def declared(version: str, encoding: str | None, standalone: int) -> None:
        if (encoding or "utf-8").lower() not in ("utf-8", "utf8", "us-ascii") and not content.isascii():
            raise rejected(f"it is said to be in {encoding}; expected UTF-8")

    def document_type(*_: object) -> None:
        raise rejected("<!DOCTYPE> is not for scenes", parser.CurrentLineNumber, parser.CurrentColumnNumber + 1)

    def begun(tag: str, attributes: dict[str, str]) -> None:
        place = f"{file} (line {parser.CurrentLineNumber}, col {parser.CurrentColumnNumber + 2})"
        found.append((tag, attributes, place))

    parser.XmlDeclHandler, parser.StartDoctypeDeclHandler, parser.StartElementHandler = declared, document_type, begun
    try:
        content.decode("utf-8")
        parser.Parse(content, True)
    except UnicodeDecodeError:
        raise rejected("it is not in UTF-8") from None
    except expat.ExpatError as error:
        raise rejected(expat.ErrorString(error.code), error.lineno, error.offset + 1) from None
    return found
