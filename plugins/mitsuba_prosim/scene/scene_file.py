"""A scene file of either kind, read once: translated if need be, parsed, changed as asked, and made into scenes."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Mapping
from contextlib import nullcontext
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any, cast

import mitsuba as mi
import prosim_scene
from prosim_scene import Document, located, meshes, misfit

from .. import registry
from ..compat import RESERVED
from . import overrides, session
from .confinement import Confinement
from .digest import digest, named_files, strings
from .errors import check_images

#: How an OpenEXR file begins.
EXR = b"v/1\x01"


class SceneFile:
    """A scene file, XML or in the thesis's language, that scenes are made from."""

    def __init__(
        self,
        path: str | Path,
        folder: str | Path,
        *,
        kept: prosim_scene.Kept | None = None,
        confined: bool = False,
        document: Document | None = None,
        **how: Any,
    ):
        """Reads ``path``, as XML if that is its suffix.

        ``folder``
            Where a translation is written; it has to stay as long as scenes are made.
        ``kept``
            What an earlier translation has left to this one.
        ``confined``
            Whether it can name no file outside its folder, see :class:`.confinement.Confinement`.
        ``document``
            The text, where it has been read already.
        ``how``
            The :class:`.overrides.Changes`, and further options of :func:`prosim_scene.translate`.

        Raises :class:`prosim_scene.SceneError`, ValueError where the scene can't be changed so, what the confinement
        raises, or whatever Mitsuba's parser does. Warns if another resolution distorts the scene's window.
        """
        given = {field.name: how.pop(field.name, None) for field in fields(overrides.Changes)}
        changes = overrides.Changes(**{name: value for name, value in given.items() if value is not None})
        self.path = self.xml = Path(path)
        self.definitions = changes.definitions
        #: The text and the places in it; None for XML.
        self.document = document
        self._kept = kept
        resolution = changes.resolution
        if self.path.suffix.lower() != ".xml":
            self.document = document or self.read()
            self._language = how | {"resolution": resolution, "samples": changes.samples}
            self.xml = prosim_scene.translate(self.document, Path(folder), kept=kept, **self._language)
            changes = replace(changes, definitions={}, resolution=None, samples=None)  # which the translation has
        #: What makes the same of the XML file alone.
        self.changes = asdict(changes)
        confinement = Confinement([self.path.parent, self.xml.parent]) if confined else None
        #: Search path before parsing; afterwards it also has the folders of the scene's ``<path>``.
        folders = [self.xml.parent, self.path.parent]
        self._begin = confinement.search_path() if confinement else session.resolver(folders)
        with session.resolving(mi.FileResolver(self._begin)):
            files = {str(self.xml)}
            if confinement is not None and self.xml is self.path:
                files = confinement.check_text(self.xml, self.definitions, self._begin)
            self.state = parse(self.xml, self.changes["definitions"])
            self._resolver = mi.file_resolver()
            if confinement is not None:
                confinement.check_state(self.state, files, self._resolver)
        self._parsed = mi.parser.ParserState(self.state)
        try:
            #: Name of the integrator that was put within ``prosim_adaptive``, if one was.
            self.wrapped = overrides.apply(self.state, changes)
        except ValueError as error:
            raise ValueError(f"{self.path}: {error}") from None
        if resolution:
            self._warn_of_distortion(*resolution)

    def read(self) -> Document:
        """What the text of a scene in the thesis's language says by now. Raises :class:`prosim_scene.SceneError`."""
        return prosim_scene.document(self.path, self.definitions)

    def sensor(self, document: Document) -> dict[str, Any]:
        """The sensor of the VIEW of ``document``, which says the same scene but for that, as a dictionary."""
        return prosim_scene.sensor(document, self._kept, **self._language)

    def digest(self) -> str:
        """SHA-256 of the content, without :attr:`changes`; see :func:`.digest.digest`."""
        with session.resolving(self._resolver):
            return digest(self._parsed)

    def named_files(self) -> list[tuple[str, Path]]:
        """``(name, path)`` of each file that the scene names; see :func:`.digest.named_files`."""
        with session.resolving(self._resolver):
            return list(named_files(self.state, self.changes["definitions"], self._begin))

    def sources(self) -> list[Path]:
        """What it is made of: the files that the scene names, and the meshes that a translation has read."""
        files = [path for _, path in self.named_files()]
        return files + [located(self.path.parent, name) for name in (meshes(self.document) if self.document else ())]

    def load(self, sampler: str | None = None) -> mi.Scene:
        """Makes a scene, with another sampler of equal sample count if one is named.

        Raises what Mitsuba does, ValueError where an integrator can't be put within ``prosim_adaptive``, and
        :class:`prosim_scene.SceneError` for an image that is not whole, at its place in the text.
        """
        state = mi.parser.ParserState(self.state)
        for node in state.nodes:
            if node.type == mi.ObjectType.Sampler and sampler:
                props = mi.Properties(sampler)
                props["sample_count"] = node.props.get("sample_count", 4)
                node.props = props
        with session.resolving(self._resolver):
            exr = any(path.open("rb").read(len(EXR)) == EXR for _, _, path in strings(state))
            try:
                with session.enough_threads() if exr else nullcontext():  # threads take time to begin
                    return instantiate(state)
            except RuntimeError as error:
                if self.document is not None:
                    check_images(self.document)
                if self.wrapped and "prosim_adaptive" in str(error):
                    raise ValueError(
                        f"{self.path}: the integrator {self.wrapped} can't be rendered within prosim_adaptive, as "
                        f"{', '.join(overrides.ENOUGH[:-1])} or {overrides.ENOUGH[-1]} asks for: "
                        f"{session.message(error)}"
                    ) from None
                raise

    def _warn_of_distortion(self, width: int, height: int) -> None:
        """Warns where pixels of this resolution are not square; see :func:`prosim_scene.misfit`."""
        for node in self.state.nodes:
            if node.type == mi.ObjectType.Sensor and node.props.plugin_name() == "prosim_window":
                left, right, bottom, top = (
                    node.props.get(name, default)
                    for name, default in (("left", -1.0), ("right", 1.0), ("bottom", -1.0), ("top", 1.0))
                )
                ratio = (right - left) / (top - bottom)
                wrong = misfit(width, height, ratio)
                if wrong is not None:
                    warnings.warn(prosim_scene.SceneWarning(f"{self.path}: {wrong}"), stacklevel=3)


def parse(path: str | Path, parameters: Mapping[str, str]) -> mi.parser.ParserState:
    """Parses an XML scene; ``parameters`` replace its ``$key`` constants. Returns Mitsuba's parser state."""
    if taken := set(RESERVED) & set(parameters):
        raise ValueError(f"-D {taken.pop()}=...: Mitsuba's Python parser keeps this name for itself; choose another")
    return mi.parser.parse_file(_config(), str(path), **parameters)


def uses(path: str | Path, definitions: Mapping[str, str], names: Iterable[str]) -> set[str]:
    """Which of these names, all of which ``definitions`` give values, a scene file of either kind says as ``$name``;
    raises what reading it raises.
    """
    names, path = set(names), Path(path)
    if path.suffix.lower() != ".xml":
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return set(prosim_scene.document(path, definitions).uses & names)
    config = _config()
    config.unused_parameters = mi.LogLevel.Trace
    with session.resolving(session.resolver([path.parent])):
        files = mi.parser.parse_file(config, str(path), **definitions).files
    text = "".join(Path(str(file)).read_text(encoding="utf-8", errors="replace") for file in files)
    return {name for name in names if re.search(rf"\${name}\b", text)}


def instantiate(state: mi.parser.ParserState) -> mi.Scene:
    """Makes the scene of a parser state, which is used up.

    Where plugins in Python are in it, one after the other: Mitsuba 3.9, which else makes them in parallel, then fails
    now and then with a string or an allocation of no sense (most often in the first scene of a process).
    """
    config = _config()
    config.parallel = not plugin_names(state) & set(registry.PLUGINS)
    config.merge_meshes = False
    mi.parser.transform_all(config, state)
    _merge_meshes(config, state)
    return cast(mi.Scene, mi.parser.instantiate(config, state))


def _merge_meshes(config: mi.parser.ParserConfig, state: mi.parser.ParserState) -> None:
    """Merges the meshes of a parsed scene that share a BSDF. Emitters stay in the order of the file.

    Mitsuba's integrators choose an emitter by its number, and merging gives the meshes another order in every process:
    see :func:`..compat.shapes_in_order`.
    """
    if state.root.type != mi.ObjectType.Scene:
        return
    root, emitters = state.root.props, []
    for name, value in list(root.items()):
        if isinstance(value, mi.Properties.ResolvedReference) and _emits(state, state.nodes[value.index()]):
            emitters.append(value)
            del root[name]
    mi.parser.transform_merge_meshes(config, state)
    root = state.root.props  # the list of nodes has moved in memory
    for number, emitter in enumerate(emitters):
        root[f"emitter_{number}"] = emitter


def _emits(state: mi.parser.ParserState, node: mi.parser.SceneNode) -> bool:
    """Whether ``node`` is an emitter or has one."""
    children = (value for _, value in node.props.items() if isinstance(value, mi.Properties.ResolvedReference))
    return node.type == mi.ObjectType.Emitter or any(
        state.nodes[child.index()].type == mi.ObjectType.Emitter for child in children
    )


def plugin_names(state: mi.parser.ParserState) -> set[str]:
    """Names of all plugins in a parsed scene."""
    return {node.props.plugin_name() for node in state.nodes}


def pick_sensor(scene: mi.Scene, index: int) -> mi.Sensor:
    """The sensor of that index, or an error that begins with the native command's words."""
    if not isinstance(scene, mi.Scene):
        raise TypeError("Root element of the input file must be a <scene> tag!")
    if not scene.sensors():
        raise ValueError(f"No sensor specified for scene: {scene}")
    if not 0 <= index < len(scene.sensors()):
        there = f"sensors 0 to {len(scene.sensors()) - 1}" if len(scene.sensors()) > 1 else "one sensor, number 0"
        raise ValueError(f"Specified sensor index is out of bounds! The scene has {there}.")
    return scene.sensors()[index]


def _config():
    return mi.parser.ParserConfig(mi.variant() or "")
