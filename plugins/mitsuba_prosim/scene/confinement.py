"""Keeps a scene to the files in its own folder: the viewer of its image need not be its author."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path

import mitsuba as mi

from ..compat import LIBRARIES, MATERIAL_FILES
from .references import references


class OutsideError(ValueError):
    """A scene names a file outside its folder."""


class Confinement:
    """Allows the files below ``folders``, the first of which is the scene's, and the files that Mitsuba is installed
    with. Links are followed.

    The methods raise :class:`OutsideError` before Mitsuba opens the file. They do not protect against somebody who
    exchanges files in these folders between the check and the reading.
    """

    def __init__(self, folders: Iterable[Path]) -> None:
        self._folders = [os.path.realpath(folder) for folder in folders]
        installed = os.path.dirname(os.path.abspath(mi.__file__))
        self._installed = [installed, os.path.realpath(installed)]

    def search_path(self) -> mi.FileResolver:
        """The folder of Mitsuba's installation, so that no file of the scene replaces one there; then the folders."""
        resolver = mi.FileResolver()
        resolver.clear()
        for folder in (self._installed[0], *self._folders):
            resolver.append(folder)
        return resolver

    def check_text(self, path: Path, resolver: mi.FileResolver) -> set[str]:
        """Checks the files that the parser opens; returns the XML files. Raises also what :func:`.references` does."""
        files = {str(path)}
        for tag, text, found, place in references(path, {}, resolver):
            wrong = self._wrong(f"<{tag}>", text, str(found))
            if "$" in text:
                wrong = f"<{tag}> names {text!r} by a parameter; write the name, or use --allow-outside"
            if wrong:
                raise OutsideError(f"At {place}: {wrong}")
            if tag == "include":
                files.add(str(found))
        return files

    def check_state(self, state: mi.parser.ParserState, files: set[str], resolver: mi.FileResolver) -> None:
        """Checks the files that plugins would open. ``files``: those of :meth:`check_text`; ``resolver``: the search
        path after parsing.
        """
        if others := {str(file) for file in state.files} - files:
            raise OutsideError(f"{others.pop()} changed while it was read; save it again")
        checked: set[tuple[str, str, str]] = set()
        for node in state.nodes:
            props, plugin = node.props, node.props.plugin_name()
            strings = [(name, props[name]) for name in props if props.type(name) == mi.Properties.Type.String]
            for name, value in {("type", plugin), *strings}:
                if (plugin, name, value) in checked:
                    continue
                checked.add((plugin, name, value))
                if wrong := self._wrong_value(plugin, name, value, resolver):
                    raise OutsideError(f"At {mi.parser.file_location(state, node)}: {wrong}")

    def _wrong_value(self, plugin: str, name: str, value: str, resolver: mi.FileResolver) -> str | None:
        """The error of a parameter that is a string, or None."""
        if name == "type":
            libraries = [str(resolver.resolve(f"plugins/{plugin}{suffix}")) for suffix in LIBRARIES]
            if re.fullmatch(r"[\w-]+", plugin) and not any(os.path.exists(p) and not self._own(p) for p in libraries):
                return None
            return f"{plugin} is not a plugin of Mitsuba; use --allow-outside"
        names = (value, *(file.format(value) for file in MATERIAL_FILES))
        errors = (self._wrong(f"the {name} of this {plugin}", n, str(resolver.resolve(n))) for n in names)
        return next(filter(None, errors), None)

    def _wrong(self, what: str, name: str, path: str) -> str | None:
        """The error of a file that ``what`` calls ``name`` and Mitsuba finds at ``path``, or None."""
        is_word = re.fullmatch(r"\w+", name) and os.path.isdir(path)  # such as "rgb"
        if not os.path.isabs(name) and (is_word or not os.path.exists(path)):
            path = os.path.join(self._folders[0], name)
        real = os.path.realpath(path)
        if self._own(path) or any(_is_below(real, folder) for folder in self._folders):
            return None
        return (
            f"{what} names {name!r}, which leads to {real}, outside the scene's folder; move the file there, or use "
            "--allow-outside"
        )

    def _own(self, path: str) -> bool:
        """Whether a file belongs to Mitsuba's installation, where links may lead anywhere."""
        return ".." not in re.split(r"[/\\]", path) and any(
            _is_below(os.path.abspath(path), folder) for folder in self._installed
        )


def _is_below(path: str, folder: str) -> bool:
    """Whether a path without links is ``folder`` or below it."""
    path, folder = os.path.normcase(path), os.path.normcase(folder)
    return path == folder or path.startswith(folder.rstrip(os.sep) + os.sep)
