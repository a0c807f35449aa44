"""Which files a scene may name where those who see its picture need not be those who wrote it."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

import mitsuba as mi

from .xml_reading import named, place_of

#: What a file of each kind is called that Mitsuba finds by a parameter of this name.
TABLES = {"material": ("data/ior/{}.eta.spd", "data/ior/{}.k.spd")}

#: How the files of Mitsuba's plugins end, on one system or another.
LIBRARIES = (".so", ".dylib", ".dll")

#: A step out of a folder.
UP = re.compile(r"(^|[/\\])\.\.([/\\]|$)")


class OutsideError(ValueError):
    """A scene names a file that lies outside its folder."""


class Confinement:
    """Lets a scene name files in ``folders`` and below alone, the first of which is its own, wherever symbolic links
    lead to; and those that Mitsuba was installed with.

    Its methods raise :class:`OutsideError` before Mitsuba reads what is refused. Who can exchange files in these
    folders between that and Mitsuba's reading is not kept out.
    """

    def __init__(self, folders: Iterable[Path]) -> None:
        self._folders = [os.path.realpath(folder) for folder in folders]
        installed = os.path.dirname(os.path.abspath(mi.__file__))
        self._own = [installed, os.path.realpath(installed)]
        self._real: dict[str, str] = {}  # folder -> where links lead to

    def check_text(self, path: Path, definitions: Mapping[str, str]) -> set[str]:
        """What the XML scene at ``path`` has Mitsuba read while it is parsed, see :func:`.xml_reading.named`; to be
        called where the search path is that of the parser. Returns the files of its text. Raises also what that raises.
        """
        files = {str(path)}
        for element in named(path, definitions, mi.file_resolver()):
            if self._leads_outside(element.name, str(element.path)):
                raise _refused(element.place, f"<{element.tag}>", element.name, str(element.path))
            if element.tag == "include":
                files.add(str(element.path))
        return files

    def check_state(self, state: mi.parser.ParserState, files: set[str]) -> None:
        """What Mitsuba has parsed from ``files``, and would make objects of; to be called where the search path is
        what parsing has left.
        """
        resolver = mi.file_resolver()
        self._check_shadows(resolver)
        if others := {str(file) for file in state.files} - files:
            raise OutsideError(f"{others.pop()} was changed while it was read; save it again")
        plugins: set[str] = set()
        for node in state.nodes:
            props = node.props
            plugin = props.plugin_name()
            if plugin not in plugins and self._is_foreign(plugin, resolver):
                place = mi.parser.file_location(state, node)
                raise OutsideError(
                    f"At {place}: {plugin} is no plugin of Mitsuba's; a scene brings its own only with --allow-outside"
                )
            plugins.add(plugin)
            for name in (name for name in props if props.type(name) == mi.Properties.Type.String):
                for said in _file_names(name, props[name]):
                    path = str(resolver.resolve(said))
                    if os.path.basename(said) == said not in (".", "..") and os.path.isdir(path):
                        continue  # a word such as "rgb", and a folder of that name where the command was given
                    if self._leads_outside(said, path):
                        place = place_of(name, mi.parser.file_location(state, node))
                        raise _refused(place, f"the {name} of this {plugin}", said, path)

    def _leads_outside(self, name: str, path: str) -> bool:
        """Whether ``name``, which Mitsuba finds at ``path``, is that of a file outside."""
        if not os.path.isabs(name) and not os.path.exists(path):  # where it would be, beside the scene
            path = os.path.join(self._folders[0], name)
        return not self._is_own(path) and not self._is_inside(path)

    def _is_inside(self, path: str) -> bool:
        """Whether it lies in the folders that are allowed, or would lie there."""
        folder, name = os.path.split(path)
        if name in ("", ".", "..") or os.path.islink(path):
            real = os.path.realpath(path)
        else:
            if folder not in self._real:
                self._real[folder] = os.path.realpath(folder)
            real = os.path.join(self._real[folder], name)
        return any(_is_below(real, allowed) for allowed in self._folders)

    def _is_own(self, path: str) -> bool:
        """Whether it is a file of Mitsuba's, by its name: links there are Mitsuba's."""
        return not UP.search(path) and any(_is_below(os.path.abspath(path), own) for own in self._own)

    def _is_foreign(self, plugin: str, resolver: mi.FileResolver) -> bool:
        """Whether Mitsuba would find the file of this plugin elsewhere than among its own."""
        if not re.fullmatch(r"[\w-]+", plugin):
            return True
        found = [str(resolver.resolve(f"plugins/{plugin}{end}")) for end in LIBRARIES]
        return any(os.path.exists(path) and not self._is_own(path) for path in found)

    def _check_shadows(self, resolver: mi.FileResolver) -> None:
        """Files that Mitsuba would take for its own: it looks for these in the folder of the scene first."""
        others = [str(folder) for folder in resolver if os.path.abspath(str(folder)) not in self._own]
        for kind in ("plugins", "data"):
            if not any(os.path.exists(os.path.join(folder, kind)) for folder in others):
                continue
            for name in _files_below(self._own[0], kind):
                path = str(resolver.resolve(name))
                if not self._is_own(path) and (kind == "plugins" or not self._is_inside(path)):
                    raise OutsideError(
                        f"{path} would take the place of Mitsuba's own {name}; expected no such file or link beside "
                        "the scene or where the command is given, or the option that allows it: --allow-outside"
                    )


@cache
def _files_below(folder: str, part: str) -> list[str]:
    """Names of the files in a part of a folder, from the latter on."""
    return [path.relative_to(folder).as_posix() for path in Path(folder, part).rglob("*.*")]


def _is_below(path: str, folder: str) -> bool:
    """Whether a path lies in a folder or below, both without links."""
    path, folder = os.path.normcase(path), os.path.normcase(folder)
    return path == folder or path.startswith(folder.rstrip(os.sep) + os.sep)


def _file_names(parameter: str, value: str) -> list[str]:
    """What Mitsuba would look for by a parameter of a plugin."""
    return [value, *(table.format(value) for table in TABLES.get(parameter, ()))]


def _refused(place: str, what: str, name: str, path: str) -> OutsideError:
    real = os.path.realpath(path)
    leads = f", which leads to {real}, outside" if os.path.exists(path) and real != name else ", which lies outside"
    return OutsideError(
        f"At {place}: {what} names {name!r}{leads} the scene's folder; expected a path in it, or the option that "
        "allows others: --allow-outside"
    )
