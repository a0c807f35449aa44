"""Reads the elements of XML scenes, and checks that a scene uses only files in the folder of the scene file."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any
from xml.parsers import expat

import mitsuba as mi

from ..compat import LIBRARIES, MATERIAL_FILES

#: Maximum depth of the XML elements, and maximum number of files that a scene includes, in a scene that is checked.
MAX_DEPTH, MAX_INCLUDES = 50, 500
#: Maximum depth in any scene: Mitsuba's parser needs stack for each level, and ends the process without enough.
DEEPEST = 1000

#: The folder of Mitsuba's installation.
INSTALLED = os.path.dirname(os.path.abspath(mi.__file__))


class OutsideError(ValueError):
    """The error that a scene refers to a file outside the folder of the scene file."""


def elements(content: bytes, strict: bool = True) -> list[tuple[str, Mapping[str, str], int, int]]:
    """Returns ``(tag, attributes, line, column)`` for each XML element in the ``content`` of a file, in its order.

    Raises RecursionError for elements that are nested more than :data:`MAX_DEPTH` deep, or :data:`DEEPEST` if
    ``strict`` is false; and ValueError for content that is not well-formed. If ``strict`` is true, also for all that
    Mitsuba's parser may read in another way: another encoding than UTF-8, a document type, a processing instruction.
    """
    deepest = MAX_DEPTH if strict else DEEPEST
    parser = expat.ParserCreate("utf-8" if strict else None)
    found, levels = list[tuple[str, Mapping[str, str], int, int]](), list[str]()

    def refuse(*_: Any) -> None:
        raise ValueError("a document type or a processing instruction")

    def declare(_: str, encoding: str | None, __: int) -> None:
        if (encoding or "utf-8").lower() not in ("utf-8", "utf8"):
            raise ValueError(f"the encoding {encoding}, not UTF-8")

    def begin(tag: str, attributes: dict[str, str]) -> None:
        levels.append(tag)
        line, column = parser.CurrentLineNumber, parser.CurrentColumnNumber
        if len(levels) > deepest:
            raise RecursionError(f"(line {line}, col {column + 1}): elements nested more than {deepest} deep")
        found.append((tag, attributes, line, column + 2))

    parser.StartElementHandler, parser.EndElementHandler = begin, lambda _: levels.pop()
    if strict:
        parser.StartDoctypeDeclHandler = parser.ProcessingInstructionHandler = refuse
        parser.XmlDeclHandler = declare
    try:
        if strict and "\0" in content.decode("utf-8"):  # expat would read UTF-16
            raise ValueError("a zero byte")
        parser.Parse(content, True)
    except (expat.ExpatError, ValueError) as error:
        words = str(error).partition(": line ")[0]
        raise ValueError(f"(line {parser.ErrorLineNumber}, col {parser.ErrorColumnNumber + 1}): {words}") from None
    return found


class Confinement:
    """Checks that a scene uses only files below the allowed ``folders``, and files of Mitsuba's installation.

    The first of ``folders`` is the folder of the scene file. A symbolic link counts as the file or folder to which it
    leads. For another file, the methods raise :class:`OutsideError` before Mitsuba opens it. An attacker who replaces a
    file between the check and the reading is not stopped.
    """

    def __init__(self, folders: Iterable[Path]) -> None:
        self._folders, self._includes = [os.path.realpath(folder) for folder in folders], 0

    def check_text(self, path: Path, folders: dict[str, None] | None = None) -> None:
        """Checks, before parsing, all files that Mitsuba's parser may open while it parses the XML file ``path``.

        ``folders`` are the folders in which Mitsuba may search for files, to which this method adds those that it
        finds. :meth:`check_state` checks the files that ``<string>`` parameters name. Raises OutsideError if a file is
        not allowed, if a name contains a ``$key`` parameter, for XML that :func:`elements` refuses, and for more than
        :data:`MAX_INCLUDES` includes. Raises OSError for a file that cannot be read.
        """
        folders = dict.fromkeys(map(str, mi.file_resolver())) if folders is None else folders
        folders[str(path.parent)] = None
        try:
            found = elements(path.read_bytes())
        except (ValueError, RecursionError) as error:
            needs = "the names of files can be checked only in well-formed XML in UTF-8, so change it"
            raise OutsideError(f"At {path} {error}; {needs}, or use --allow-outside") from None
        for tag, attributes, line, column in found:
            name = attributes.get("value" if tag == "path" else "filename")
            if tag not in ("include", "spectrum", "path") or name is None:
                continue
            places = [place for folder in folders if os.path.exists(place := os.path.join(folder, name))]
            wrong = self._refusal(f"<{tag}>", name, *(places or [name]))
            if "$" in name:
                wrong = f"<{tag}> names {name!r} by a parameter; write the name, or use --allow-outside"
            self._includes += tag == "include"
            if self._includes > MAX_INCLUDES:
                wrong = f"the scene includes more than {MAX_INCLUDES} files; use --allow-outside"
            if wrong:
                raise OutsideError(f"At {path} (line {line}, col {column}): {wrong}")
            folders.update(dict.fromkeys(places if tag == "path" else ()))
            for place in places if tag == "include" else ():
                self.check_text(Path(place), folders)

    def check_state(self, state: mi.parser.ParserState) -> None:
        """Checks the XML files of the parsed scene ``state``, the names of its plugins, and all files that string
        parameters name. Raises OutsideError for the first that is not allowed.
        """
        for file in map(str, state.files):
            if wrong := self._refusal("an <include>", file, file):
                # :meth:`check_text` has allowed all includes before the parser read them.
                raise OutsideError(f"{file} changed while it was read: {wrong}")
        for node in state.nodes:
            props, plugin = node.props, node.props.plugin_name()
            strings = [(name, props[name]) for name in props if props.type(name) == mi.Properties.Type.String]
            for name, value in [("type", plugin), *strings]:
                if wrong := self._refusal_of_value(plugin, name, value):
                    raise OutsideError(f"At {mi.parser.file_location(state, node)}: {wrong}")

    def _refusal_of_value(self, plugin: str, name: str, value: str) -> str | None:
        """Returns an error message if the string parameter ``name`` of a ``plugin`` names a file that is not allowed.

        The ``value`` may be the name of a file or of a material, whose :data:`.MATERIAL_FILES` Mitsuba opens, or any
        other text. If ``name`` is "type", the plugin itself must be one of Mitsuba.
        """
        resolver = mi.file_resolver()
        if name == "type":
            libraries = (str(resolver.resolve(f"plugins/{plugin}{suffix}")) for suffix in LIBRARIES)
            others = [path for path in libraries if os.path.exists(path) and not self._is_installed(path)]
            if re.fullmatch(r"[\w-]+", plugin) and not others:
                return None
            return f"{plugin} is not a plugin of Mitsuba; use --allow-outside"
        for file in (value, *(file.format(value) for file in MATERIAL_FILES)):
            place = str(resolver.resolve(file))
            is_word = re.fullmatch(r"\w+", file) and os.path.isdir(place)  # a word such as "rgb" names no file
            if not is_word and (wrong := self._refusal(f"the {name} of this {plugin}", file, place)):
                return wrong
        return None

    def _refusal(self, what: str, name: str, *places: str) -> str | None:
        """Returns an error message if one of ``places``, all paths at which Mitsuba may find a file, is not allowed.

        ``what`` describes the element or parameter that contains the ``name`` of the file. A relative path at which no
        file exists counts as a path in the folder of the scene file.
        """
        for path in places:
            if not os.path.isabs(path) and not os.path.exists(path):
                path = os.path.join(self._folders[0], name)
            real = Path(os.path.realpath(path))
            if not self._is_installed(path) and not any(map(real.is_relative_to, self._folders)):
                return (
                    f"{what} names {name!r}, which leads to {real}, outside the scene's folder; move the file there, "
                    "or use --allow-outside"
                )
            if os.path.exists(real) and not (os.path.isfile(real) or os.path.isdir(real)):
                return f"{what} names {name!r}, which is a device or a pipe; use a file"
        return None

    def _is_installed(self, path: str) -> bool:
        """Tells whether ``path`` is in the folder of Mitsuba's installation, whose symbolic links are trusted. A path
        that contains ".." is not.
        """
        inside = map(Path(os.path.abspath(path)).is_relative_to, (INSTALLED, os.path.realpath(INSTALLED)))
        return ".." not in re.split(r"[/\\]", path) and any(inside)
