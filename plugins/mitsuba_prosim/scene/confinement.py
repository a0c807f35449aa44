"""Keeps a scene to the files in its own folder: whoever sees its picture need not be the one who wrote it."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

import mitsuba as mi

from ..compat import DATA_FILES, LIBRARIES
from .references import references


class OutsideError(ValueError):
    """A scene names a file outside its folder."""


class Confinement:
    """Allows files in ``folders`` and below, wherever links lead, and those that Mitsuba is installed with. The first
    of the folders is the scene's own.

    Its methods raise :class:`OutsideError` before Mitsuba reads the file. They do not help against somebody who can
    exchange files in these folders between the check and the reading.
    """

    def __init__(self, folders: Iterable[Path]) -> None:
        self._folders = [os.path.realpath(folder) for folder in folders]
        installed = os.path.dirname(os.path.abspath(mi.__file__))
        self._own = [installed, os.path.realpath(installed)]

    def search_path(self) -> mi.FileResolver:
        """Mitsuba's own files come first, so that no file beside the scene replaces them; then the folders."""
        resolver = mi.FileResolver()
        resolver.clear()
        for folder in (self._own[0], *self._folders):
            resolver.append(folder)
        return resolver

    def check_text(self, path: Path, definitions: Mapping[str, str], resolver: mi.FileResolver) -> set[str]:
        """Checks what the parser opens by itself; returns the XML files. Raises also what :func:`.references` does."""
        files = {str(path)}
        for reference in references(path, definitions, resolver):
            if words := self._outside(f"<{reference.tag}>", reference.name, str(reference.path)):
                raise OutsideError(f"At {reference.place}: {words}")
            if reference.tag == "include":
                files.add(str(reference.path))
        return files

    def check_state(self, state: mi.parser.ParserState, files: set[str], resolver: mi.FileResolver) -> None:
        """Checks what plugins would open. ``files``: the XML files that were checked; ``resolver``: the search path
        after parsing.
        """
        if others := {str(file) for file in state.files} - files:
            raise OutsideError(f"{others.pop()} was changed while it was read; save it again")
        checked: set[tuple[str, str]] = set()
        for node in state.nodes:
            props, plugin = node.props, node.props.plugin_name()
            strings = [(name, props[name]) for name in props if props.type(name) == mi.Properties.Type.String]
            for said in {("type", plugin), *strings} - checked:
                if words := self._wrong(plugin, *said, resolver):
                    raise OutsideError(f"At {mi.parser.file_location(state, node)}: {words}")
                checked.add(said)

    def _wrong(self, plugin: str, parameter: str, value: str, resolver: mi.FileResolver) -> str | None:
        """What is wrong with a parameter of a plugin that is a string, if anything."""
        if parameter == "type" and self._is_foreign(plugin, resolver):
            return f"{plugin} is no plugin of Mitsuba's; a scene brings its own only with --allow-outside"
        for name in (value, *(file.format(value) for file in DATA_FILES.get(parameter, ()))):
            path = str(resolver.resolve(name))
            if os.path.basename(name) == name not in (".", "..") and os.path.isdir(path):
                continue  # a word such as "rgb", where a folder has that name
            if words := self._outside(f"the {parameter} of this {plugin}", name, path):
                return words
        return None

    def _outside(self, what: str, name: str, path: str) -> str | None:
        """What is wrong with a file that ``what`` calls ``name`` and Mitsuba finds at ``path``, if anything."""
        if not os.path.isabs(name) and not os.path.exists(path):
            path = os.path.join(self._folders[0], name)
        real = os.path.realpath(path)
        if self._is_own(path) or any(_is_below(real, folder) for folder in self._folders):
            return None
        leads = f", which leads to {real}, outside" if os.path.exists(path) and real != name else ", which lies outside"
        return (
            f"{what} names {name!r}{leads} the scene's folder; expected a path in it, or the option that allows "
            "others: --allow-outside"
        )

    def _is_own(self, path: str) -> bool:
        """Whether Mitsuba is installed with the file; links in its folder are its own."""
        return ".." not in re.split(r"[/\\]", path) and any(_is_below(os.path.abspath(path), own) for own in self._own)

    def _is_foreign(self, plugin: str, resolver: mi.FileResolver) -> bool:
        """Whether Mitsuba would load a plugin from a file that is not its own."""
        found = [str(resolver.resolve(f"plugins/{plugin}{suffix}")) for suffix in LIBRARIES]
        return not re.fullmatch(r"[\w-]+", plugin) or any(os.path.exists(p) and not self._is_own(p) for p in found)


def _is_below(path: str, folder: str) -> bool:
    """Whether a path lies in a folder or below; both are without links."""
    path, folder = os.path.normcase(path), os.path.normcase(folder)
    return path == folder or path.startswith(folder.rstrip(os.sep) + os.sep)
