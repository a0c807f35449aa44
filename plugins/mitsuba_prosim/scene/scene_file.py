"""A scene file in XML or in the thesis's language: translated, parsed, changed and loaded."""

from __future__ import annotations

import hashlib
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import prosim_scene
from prosim_scene import Document, located, meshes

from .. import compat, registry
from . import overrides, session
from .confinement import Confinement
from .errors import check_images
from .references import UnreadableError, references


class SceneFile:
    """A scene file, read once. :meth:`load` makes scenes of it."""

    def __init__(
        self,
        path: str | Path,
        folder: Path,
        cache: prosim_scene.TranslationCache | None = None,
        confined: bool = False,
        **how: Any,
    ) -> None:
        """Reads the scene at ``path``: XML if that is its suffix, else the thesis's language.

        ``folder``
            Folder of the translation; it has to exist as long as scenes are loaded.
        ``cache``
            The cache of translations.
        ``confined``
            Whether the scene may name only files in its folder, see :class:`.confinement.Confinement`.
        ``how``
            The :class:`.overrides.Changes`, and options of :func:`prosim_scene.translate`.

        Raises :class:`prosim_scene.SceneError`, ValueError where the changes do not fit the scene, and what the
        confinement and Mitsuba's parser raise. Warns if another resolution distorts the image.
        """
        given = {field.name: how.pop(field.name, None) for field in fields(overrides.Changes)}
        changes = overrides.Changes(**{name: value for name, value in given.items() if value is not None})
        self.path = self.xml = Path(path)
        self.definitions = changes.definitions
        #: The parsed text; None for XML.
        self.document: Document | None = None
        resolution = changes.resolution
        if self.path.suffix.lower() != ".xml":
            self.document = prosim_scene.document(self.path, self.definitions)
            self._language = how | {"resolution": resolution, "samples": changes.samples}
            self.xml = prosim_scene.translate(self.document, Path(folder), cache=cache, **self._language)
            changes = replace(changes, definitions={}, resolution=None, samples=None)  # the translation has these
        #: The arguments with which the XML file makes the same scene.
        self.changes = asdict(changes)
        folders = [self.xml.parent, self.path.parent]
        confinement = Confinement(reversed(folders)) if confined else None
        #: The search path before parsing; ``<path>`` elements extend it.
        self._begin = confinement.search_path() if confinement else session.resolver(folders)
        with session.resolving(mi.FileResolver(self._begin)):
            is_translation = self.xml is not self.path
            files = {str(self.xml)}
            if confinement and not is_translation:
                files = confinement.check_text(self.xml, self._begin)
            self.state = parse(self.xml, changes.definitions)
            self._resolver = mi.file_resolver()
            if confinement:
                confinement.check_state(self.state, files, self._resolver)
            self._digest = mi.parser.ParserState(self.state)
        try:
            #: Name of the integrator that was put inside ``prosim_adaptive``, or None.
            self.wrapped = overrides.apply(self.state, changes)
        except ValueError as error:
            raise ValueError(f"{self.path}: {error}") from None
        if resolution and (wrong := overrides.distortion(self.state, *resolution)):
            warnings.warn(prosim_scene.SceneWarning(f"{self.path}: {wrong}"), stacklevel=2)

    def digest(self) -> str:
        """SHA-256 of the content of the scene and of the files that it names, without :attr:`changes`.

        Comments, names of files and formats of numbers do not matter.
        """
        state = mi.parser.ParserState(self._digest)
        for props, name, path in self._strings(state):
            props[name] = hashlib.sha256(path.read_bytes()).hexdigest()
        versions = " ".join(map(str, state.versions))
        return hashlib.sha256(f"{versions}\n{mi.parser.write_string(state)}".encode()).hexdigest()

    def named_files(self) -> list[tuple[str, Path]]:
        """``(name, path)`` of each file that the scene names, without XML files."""
        files = [(props[name], path) for props, name, path in self._strings(self.state)]
        with suppress(UnreadableError):
            for tag, text, path, _ in references(self.xml, self.changes["definitions"], self._begin):
                if tag == "spectrum" and path.is_file():  # the parser has replaced it by its content
                    files.append((text, path))
        return files

    def sources(self) -> list[Path]:
        """The files that the scene names, and the meshes that a translation has read."""
        files = [path for _, path in self.named_files()]
        return files + [located(self.path.parent, name) for name in (meshes(self.document) if self.document else ())]

    def _strings(self, state: mi.parser.ParserState) -> Iterator[tuple[mi.Properties, str, Path]]:
        """The parameters that name a file, and its path."""
        for props in (node.props for node in state.nodes):
            for name in [name for name in props if props.type(name) == mi.Properties.Type.String and props[name]]:
                path = Path(str(self._resolver.resolve(props[name])))
                if path.is_file():
                    yield props, name, path

    def load(self, sampler: str | None = None) -> mi.Scene:
        """Makes a scene; ``sampler``: the plugin that takes the place of its sampler, with as many samples.

        Raises Mitsuba's errors, ValueError where ``prosim_adaptive`` can't hold the integrator, and
        :class:`prosim_scene.SceneError` for a damaged image, at its place in the text.
        """
        state = mi.parser.ParserState(self.state)
        for node in state.nodes:
            if node.type == mi.ObjectType.Sampler and sampler:
                props = mi.Properties(sampler)
                props["sample_count"] = node.props.get("sample_count", 4)
                node.props = props
        try:
            with session.resolving(self._resolver), session.enough_threads():
                return instantiate(state)
        except RuntimeError as error:
            if self.document is not None:
                check_images(self.document)
            if self.wrapped and "prosim_adaptive" in str(error):
                raise ValueError(
                    f"{self.path}: {', '.join(overrides.ENOUGH)} need prosim_adaptive, which can't hold the integrator "
                    f"{self.wrapped}: {session.message(error)}"
                ) from None
            raise


def parse(path: str | Path, parameters: Mapping[str, str]) -> mi.parser.ParserState:
    """Parses an XML scene; ``parameters`` replace its ``$key`` constants. Returns Mitsuba's parser state."""
    if taken := set(compat.RESERVED) & set(parameters):
        raise ValueError(f"-D {taken.pop()}=...: Mitsuba reserves this name; choose another")
    return mi.parser.parse_file(_config(), str(path), **parameters)


def instantiate(state: mi.parser.ParserState) -> mi.Scene:
    """Makes the scene of a parser state, which is used up."""
    return compat.instantiate(_config(), state, registry.PLUGINS)


def uses(path: str | Path, definitions: Mapping[str, str], names: Iterable[str]) -> set[str]:
    """Those of ``names`` that occur as ``$name`` in a scene file or in the files that it includes."""
    files = [Path(path)]
    if files[0].suffix.lower() == ".xml":
        search = session.resolver([files[0].parent])
        files += [found for tag, _, found, _ in references(path, definitions, search) if tag == "include"]
    text = "".join(file.read_text(encoding="utf-8", errors="replace") for file in files)
    return {name for name in names if re.search(rf"\${name}\b", text)}


def pick_sensor(scene: mi.Scene, index: int) -> mi.Sensor:
    """The sensor of that index. Raises an error that begins as that of the native command."""
    if not isinstance(scene, mi.Scene):
        raise TypeError("Root element of the input file must be a <scene> tag!")
    sensors = scene.sensors()
    if not sensors:
        raise ValueError(f"No sensor specified for scene: {scene}")
    if not 0 <= index < len(sensors):
        there = f"sensors 0 to {len(sensors) - 1}" if len(sensors) > 1 else "one sensor, number 0"
        raise ValueError(f"Specified sensor index is out of bounds! The scene has {there}.")
    return sensors[index]


def _config() -> mi.parser.ParserConfig:
    return mi.parser.ParserConfig(mi.variant() or "")
