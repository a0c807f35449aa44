"""Finds the files that an XML scene names, and checks that these files are in the scene's folder."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import mitsuba as mi

from ..compat import LIBRARIES, MATERIAL_FILES

#: Pattern of an XML element that names a file or a folder, or defines a parameter. The pattern also matches within
#: comments. And pattern of one attribute of such an element.
ELEMENT = re.compile(r"""(?=<(include|spectrum|path|default)\b((?:[^<>"']|"[^"]*"|'[^']*')*))""")
ATTRIBUTE = re.compile(r"""([^\s=<>"']+)\s*=\s*("[^"]*"|'[^']*')""")

#: Pattern of a declared encoding that is not UTF-8.
OTHER_ENCODING = re.compile(r"""\s*<\?xml[^>]*encoding\s*=\s*["'](?!utf-?8["'])""", re.IGNORECASE)


#: The folder of Mitsuba's installation.
INSTALLED = os.path.dirname(os.path.abspath(mi.__file__))


class OutsideError(ValueError):
    """A scene names a file outside its folder."""


def named(text: str) -> Iterator[tuple[str, str, int]]:
    """Yields ``(element, name, position)`` for each file and each folder that an :data:`ELEMENT` of an XML text names.

    An element ``path`` names a folder by its attribute ``value``. Other elements name a file by ``filename``.
    ``name`` is the value of this attribute as written in the text, before parameters and entities are replaced.
    ``position`` is the offset of the element in the text.
    """
    for found in ELEMENT.finditer(text):
        for attribute, value in ATTRIBUTE.findall(found[2]):
            if attribute == ("value" if found[1] == "path" else "filename"):
                yield found[1], value[1:-1], found.start()


class Confinement:
    """Allows only files below ``folders``, and files of Mitsuba's installation.

    The first of ``folders`` is the scene's folder. Symbolic links are followed. The methods raise :class:`OutsideError`
    before Mitsuba opens a file. The checks do not protect against somebody who exchanges files in the allowed folders
    between the check and the reading.
    """

    def __init__(self, folders: Iterable[Path]) -> None:
        self._folders = [os.path.realpath(folder) for folder in folders]

    def check_text(self, path: Path) -> None:
        """Checks all files that Mitsuba's parser may open for the XML file ``path``; call this method before parsing.

        Files that <string> parameters name are not found here; see :meth:`check_state`. Raises OutsideError if a file
        is not allowed or a name cannot be checked, and OSError if ``path`` or an XML file that it includes cannot be
        read.
        """
        folders, texts = [str(folder) for folder in mi.file_resolver()], [path]
        for file in texts:  # the list grows in the loop
            folders.append(str(file.parent))
            try:
                text = file.read_text(encoding="utf-8")
            except UnicodeDecodeError:
                text = "\0"
            if "\0" in text or OTHER_ENCODING.match(text):
                raise OutsideError(f"{file} is not in UTF-8, so its names can't be checked; save it in UTF-8")
            for tag, name, position in named(text):
                found = [place for folder in folders if os.path.exists(place := os.path.join(folder, name))]
                wrong = self._refusal(f"<{tag}>", name, *(found or [name]))
                # A parameter ($), an entity (&) or white space that XML replaces: the parser reads another name.
                if re.search(r"[$&]|[^\S ]", name):
                    wrong = f"<{tag}> names {name!r} by parameter or entity; write the name, or use --allow-outside"
                if wrong:
                    line, column = text.count("\n", 0, position) + 1, position - text.rfind("\n", 0, position)
                    raise OutsideError(f"At {file} (line {line}, col {column + 1}): {wrong}")
                folders += found if tag == "path" else []
                texts += [place for place in map(Path, found) if tag == "include" and place not in texts]

    def check_state(self, state: mi.parser.ParserState) -> None:
        """Checks the files that the parser has read, and the files that plugins would open in Mitsuba's search path."""
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
        """Returns the error message for a parameter that is a string; None if the parameter is allowed.

        ``plugin`` is the plugin with this parameter. ``name`` and ``value`` are those of the parameter; the name "type"
        stands for the name of the plugin.
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
        """Returns the error message for a file outside the allowed folders; None if the file is allowed.

        ``what`` is the element or the parameter that names the file, in words. ``name`` is the name that the scene
        gives. ``places`` are all paths at which Mitsuba may find the file.
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
        return None

    def _is_installed(self, path: str) -> bool:
        """Tells whether a file belongs to Mitsuba's installation.

        The test uses the path as written, because symbolic links of an installation may lead out of it and are trusted.
        A path with ".." is not trusted.
        """
        inside = map(Path(os.path.abspath(path)).is_relative_to, (INSTALLED, os.path.realpath(INSTALLED)))
        return ".." not in re.split(r"[/\\]", path) and any(inside)
