"""A scene file of either kind, read once: translated if need be, parsed, changed as asked, and made into scenes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mitsuba as mi
import prosim_scene

from . import session


class SceneFile:
    """A scene file, XML or in the thesis's language, that scenes are made from."""

    def __init__(self, path: str | Path, folder: str | Path, *, definitions: Mapping[str, str] | None = None,
                 resolution: tuple[int, int] | None = None, crop: tuple[int, int, int, int] | None = None,
                 samples: int | None = None, **language: Any):
        """Reads ``path``, as XML if that is its suffix.

        ``folder``
            Where a translation is written; it has to stay as long as scenes are made.
        ``definitions``
            Values for the ``$key`` constants of XML.
        ``resolution``, ``crop``, ``samples``
            (width, height), (x, y, width, height), both in pixels, and N of the N-rook sampling instead of the scene's.
        ``language``
            Further options of :func:`prosim_scene.translate`.

        Raises :class:`prosim_scene.SceneError`, or whatever Mitsuba's parser raises.
        """
        self.path = self.xml = Path(path)
        self.resolution, self.definitions = resolution, dict(definitions or {})
        if self.path.suffix.lower() != ".xml":
            self.xml = prosim_scene.translate(self.path, Path(folder), resolution=resolution, samples=samples, **language)
            resolution = samples = None  # said in the translation
        with self._search_paths():
            self.state = parse(self.xml, self.definitions)
        for node in self.state.nodes:
            if node.type == mi.ObjectType.Film:
                _override(node.props, ("width", "height"), resolution)
                _override(node.props, ("crop_offset_x", "crop_offset_y", "crop_width", "crop_height"), crop)
            elif node.type == mi.ObjectType.Integrator and node.props.plugin_name() == "prosim" and samples:
                node.props["samples"] = samples

    def load(self, sampler: str | None = None) -> mi.Scene:
        """Makes a scene, with another sampler of equal sample count if one is named."""
        state = mi.parser.ParserState(self.state)
        for node in state.nodes:
            if node.type == mi.ObjectType.Sampler and sampler:
                props = mi.Properties(sampler)
                props["sample_count"] = node.props.get("sample_count", 4)
                node.props = props
        with self._search_paths(), session.enough_threads():
            return instantiate(state)

    def _search_paths(self):
        return session.search_paths(first=[self.xml.parent, self.path.parent])


def parse(path: str | Path, parameters: Mapping[str, str]) -> mi.parser.ParserState:
    """Parses an XML scene; ``parameters`` replace its ``$key`` constants. Returns Mitsuba's parser state."""
    if taken := {"config", "filename"} & set(parameters):
        raise ValueError(f'-D {taken.pop()}=...: Mitsuba\'s Python parser keeps this name for itself; choose another')
    return mi.parser.parse_file(mi.parser.ParserConfig(mi.variant()), str(path), **parameters)


def instantiate(state: mi.parser.ParserState) -> mi.Scene:
    """Makes the scene of a parser state, which is used up."""
    config = mi.parser.ParserConfig(mi.variant())
    mi.parser.transform_all(config, state)
    return mi.parser.instantiate(config, state)


def plugin_names(state: mi.parser.ParserState) -> set[str]:
    """Names of all plugins in a parsed scene."""
    return {node.props.plugin_name() for node in state.nodes}


def pick_sensor(scene: mi.Scene, index: int) -> mi.Sensor:
    """The sensor of that index, or an error in the native command's words."""
    if not isinstance(scene, mi.Scene):
        raise TypeError("Root element of the input file must be a <scene> tag!")
    if not scene.sensors():
        raise ValueError(f"No sensor specified for scene: {scene}")
    if not 0 <= index < len(scene.sensors()):
        raise ValueError("Specified sensor index is out of bounds!")
    return scene.sensors()[index]


def _override(props, names, values):
    """Sets named properties, if values are given."""
    for name, value in zip(names, values or ()):
        props[name] = value
