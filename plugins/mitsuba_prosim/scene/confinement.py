"""Finds the names of files in an XML scene, and checks that these files are in the folder of the scene file."""

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
    """The error that a scene refers to a file outside the folder of the scene file."""


def named(text: str) -> Iterator[tuple[str, str, int]]:
    """Yields ``(element, name, position)`` for each XML element ``include``, ``spectrum`` or ``path`` in ``text`` that
    contains the name of a file or folder, even within an XML comment.

    ``element`` is the tag of the XML element. In an element ``path``, the attribute ``value`` is the name of a folder.
    In the elements ``include`` and ``spectrum``, the attribute ``filename`` is the name of a file. ``name`` is the name
    of the file or folder as written in the text, before ``$key`` parameters and XML entities are replaced. ``position``
    is the offset of the XML element from the beginning of the text, in characters.
    """
    for found in ELEMENT.finditer(text):
        for attribute, value in ATTRIBUTE.findall(found[2]):
            if attribute == ("value" if found[1] == "path" else "filename"):
                yield found[1], value[1:-1], found.start()


class Confinement:
    """Checks that a scene uses only files below the allowed ``folders``, and files of Mitsuba's installation.

    The first of ``folders`` is the folder of the scene file. A symbolic link counts as the file or folder to which it
    leads. For a file that is not allowed, the methods raise :class:`OutsideError` before Mitsuba opens the file. The
    checks do not protect against an attacker who replaces a file in an allowed folder after the check, but before
    Mitsuba reads the file.
    """

    def __init__(self, folders: Iterable[Path]) -> None:
        self._folders = [os.path.realpath(folder) for folder in folders]

    def check_text(self, path: Path) -> None:
        """Checks all files that Mitsuba's parser may open while it parses the XML file ``path``; call this method
        before parsing.

        This method does not check the files that ``<string>`` parameters of plugins name; :meth:`check_state` checks
        these files. Raises OutsideError if a file is not allowed, if the name of a file contains a ``$key`` parameter,
        an XML entity or white space other than blanks, or if an XML file is not in UTF-8. Raises OSError if the file
        ``path`` or an included XML file cannot be read.
        """
        folders, texts = [str(folder) for folder in mi.file_resolver()], [path]
        for file in texts:  # the list grows in the loop
            folders.append(str(file.parent))
            try:
                text = file.read_text(encoding="utf-8")
            except UnicodeDecodeError:
                text = "\0"  # is refused in the next lines
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
        """Checks the XML files that the parser has read, the names of plugins, and all files that plugins would open
        because a string parameter contains the name of the file. ``state`` is the parsed scene. Raises OutsideError for
        the first file or plugin that is not allowed.
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
        """Returns an error message if the string parameter ``name`` of a plugin names a file that is not allowed, else
        None.

        ``plugin`` is the name of the plugin that has the parameter. ``value`` is the value of the parameter, which may
        be the name of a file, the name of a material for which Mitsuba opens the :data:`.MATERIAL_FILES`, or any other
        text. If ``name`` is "type", the function checks instead that the name ``plugin`` consists of letters, digits,
        "_" and "-", and that Mitsuba cannot load ``plugin`` from a file outside Mitsuba's installation.
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
        """Returns an error message if a file is neither in an allowed folder nor in Mitsuba's installation; None if the
        file is allowed.

        ``what`` describes, in words for the message, the XML element or the parameter that contains the name of the
        file. ``name`` is the name of the file as the scene contains it. ``places`` are all paths at which Mitsuba may
        find the file; each of these paths must be allowed. A relative path at which no file exists counts as a path in
        the folder of the scene file.
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
        """Tells whether the file ``path`` is in the folder of Mitsuba's installation.

        The function does not follow symbolic links, because links in Mitsuba's installation are trusted, even if they
        lead to other folders. A path that contains ".." never counts as a part of Mitsuba's installation.
        """
        inside = map(Path(os.path.abspath(path)).is_relative_to, (INSTALLED, os.path.realpath(INSTALLED)))
        return ".." not in re.split(r"[/\\]", path) and any(inside)
