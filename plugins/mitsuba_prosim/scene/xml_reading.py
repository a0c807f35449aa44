"""What an XML scene names while Mitsuba reads its text: the files that it includes, those of spectra, and the folders
that it has searched.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

import mitsuba as mi


class Element(NamedTuple):
    """How an element begins, and where: ``line`` and ``column``, from 1, of its tag's name."""

    tag: str
    attributes: dict[str, str]
    line: int
    column: int


class Named(NamedTuple):
    """What an element of a text names. ``tag``: ``include``, ``spectrum`` or ``path``; ``name``: with values for its
    parameters; ``path``: where Mitsuba finds that, or looks for it last; ``place``: of the element, in words.
    """

    tag: str
    name: str
    path: Path
    place: str


class UnreadableError(ValueError):
    """The text is not what every reader of XML takes for the same."""


def named(path: str | Path, definitions: Mapping[str, str], resolver: mi.FileResolver) -> Iterator[Named]:
    """What the XML scene at ``path`` names, and what the files that it includes do, in the order in which Mitsuba's
    parser comes to it. ``definitions``: values of its parameters; ``resolver``: the search path to begin with, which is
    left as it is.

    A file that is included is read when the next one is asked for, so that who asks may decide about it first. Raises
    UnreadableError, or OSError for a file that can't be read.
    """
    parameters = sorted((("$" + name, value) for name, value in definitions.items()), key=lambda p: -len(p[0]))
    yield from _named(str(path), parameters, mi.FileResolver(resolver), 0)


def _named(file: str, parameters: list[tuple[str, str]], resolver: mi.FileResolver, depth: int) -> Iterator[Named]:
    beside = os.path.dirname(file)
    for element in elements(file):
        place = f"{file} (line {element.line}, col {element.column})"
        values = {name: _substituted(value, parameters, place) for name, value in element.attributes.items()}
        if element.tag == "default":
            _define(parameters, "$" + values.get("name", ""), values.get("value", ""))
        elif element.tag == "spectrum" and (name := values.get("filename")):
            yield Named("spectrum", name, Path(str(resolver.resolve(name))), place)
        elif element.tag == "path" and (name := values.get("value")):
            folder = os.path.join(beside, name)
            if not os.path.isabs(name) and not os.path.exists(folder):
                folder = str(resolver.resolve(name))
            yield Named("path", name, Path(folder), place)
            resolver.prepend(folder)
        elif element.tag == "include" and (name := values.get("filename")):
            within = mi.FileResolver(resolver)
            if beside:
                within.prepend(beside)
            included = str(within.resolve(name))
            yield Named("include", name, Path(included), place)
            if not os.path.isfile(included):
                return  # as far as Mitsuba comes
            if depth + 1 >= mi.parser.ParserConfig("").max_include_depth:
                raise UnreadableError(f"At {place}: files include each other more deeply than Mitsuba follows them")
            yield from _named(included, parameters, within, depth + 1)


def elements(file: str | Path) -> list[Element]:
    """The elements of an XML file in the order in which they begin.

    Raises UnreadableError where it is not well-formed, or where Mitsuba's parser, which knows neither encodings nor
    document types, might read something else in it; OSError.
    """
    content = Path(file).read_bytes()
    found: list[Element] = []
    parser = expat.ParserCreate("utf-8")

    def reject(words: str, line: int = 1, column: int = 1) -> UnreadableError:
        return UnreadableError(f'Parsing of XML file "{file}" failed: {words} (line {line}, col {column})')

    def declared(version: str, encoding: str | None, standalone: int) -> None:
        if (encoding or "utf-8").lower() not in ("utf-8", "utf8", "us-ascii") and not content.isascii():
            raise reject(f"it is said to be in {encoding}; expected UTF-8")

    def document_type(*_: object) -> None:
        raise reject("<!DOCTYPE> is not for scenes", parser.CurrentLineNumber, parser.CurrentColumnNumber + 1)

    def begun(tag: str, attributes: dict[str, str]) -> None:
        found.append(Element(tag, attributes, parser.CurrentLineNumber, parser.CurrentColumnNumber + 2))

    parser.XmlDeclHandler, parser.StartDoctypeDeclHandler, parser.StartElementHandler = declared, document_type, begun
    try:
        content.decode("utf-8")
        parser.Parse(content, True)
    except UnicodeDecodeError:
        raise reject("it is not in UTF-8") from None
    except expat.ExpatError as error:
        raise reject(expat.ErrorString(error.code), error.lineno, error.offset + 1) from None
    return found


def place_of(parameter: str, place: str) -> str:
    """Where the string of this name is that the element at ``place`` has; ``place`` where that is not found."""
    if (said := re.fullmatch(r"(.*) \(line (\d+), col (\d+)\)", place, re.DOTALL)) is None:
        return place
    file, begin = said[1], (int(said[2]), int(said[3]))
    for tag, attributes, line, column in elements(file):
        if (line, column) > begin and tag == "string" and attributes.get("name") == parameter:
            return f"{file} (line {line}, col {column})"
    return place


def _substituted(value: str, parameters: list[tuple[str, str]], place: str) -> str:
    """``value`` with the values of parameters, longest name first, as Mitsuba puts them in: a backslash before ``$``
    takes its meaning away.
    """
    if "$" not in value:
        return value
    for name, new in parameters:
        at = 0
        while (at := value.find(name, at)) >= 0:
            if at and value[at - 1] == "\\":
                at += len(name)
            else:
                value = value[:at] + new + value[at + len(name) :]
                at += len(new)
    if unknown := re.search(r"(?<!\\)\$\w*", value):
        raise UnreadableError(f"Error while loading {place}: undefined parameter: {unknown[0]}")
    return value.replace("\\$", "$")


def _define(parameters: list[tuple[str, str]], name: str, value: str) -> None:
    """Gives a parameter a value that has none; those of longer names come first."""
    if all(known != name for known, _ in parameters):
        before = [len(known) >= len(name) for known, _ in parameters]
        parameters.insert(before.index(False) if False in before else len(before), (name, value))
