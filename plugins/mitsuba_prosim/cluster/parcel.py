"""A scene on its way to another machine: its text, and the files that it names."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi

from ..scene import atomic, scene_file


@dataclass(frozen=True)
class Parcel:
    """What makes a scene. ``key``: the same for scenes of the same content; ``main``: name of its XML file;
    ``contents``: of all its files by their names, which lead from folder to folder as those in the text do;
    ``changes``: further arguments of :class:`.scene_file.SceneFile`; ``sensor``: number of its sensor.
    """

    key: str
    main: str
    contents: Mapping[str, bytes]
    changes: Mapping[str, Any]
    sensor: int

    @classmethod
    def of(cls, file: scene_file.SceneFile, sensor: int = 0) -> Parcel:
        """All that makes the scene of ``file``.

        Raises ValueError where it names a file by an absolute path, or one outside of its folder: what travels is what
        lies beside the scene, and nothing else. OSError.
        """
        places = dict(travelling(file))
        root = Path(os.path.commonpath([place.parent for place in places]))
        contents = {place.relative_to(root).as_posix(): path.read_bytes() for place, path in places.items()}
        main = Path(os.path.abspath(file.xml)).relative_to(root).as_posix()
        said = json.dumps([file.digest(), file.changes, sensor], sort_keys=True)
        return cls(hashlib.sha256(said.encode()).hexdigest(), main, contents, file.changes, sensor)

    def load(self) -> tuple[mi.Scene, mi.Sensor]:
        """Its scene and its sensor. Raises what their makers raise."""
        with atomic.scratch() as folder:
            for name, content in self.contents.items():
                path = folder / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
            scene = scene_file.SceneFile(folder / self.main, folder, **self.changes).load()
            return scene, scene_file.pick_sensor(scene, self.sensor)


def travelling(file: scene_file.SceneFile) -> Iterator[tuple[Path, Path]]:
    """``(place, path)`` of the files that make a scene; ``place``: where its name in the text leads to, from the folder
    of the XML file. Raises ValueError.
    """
    home = Path(os.path.abspath(file.xml.parent))
    inside = [folder.resolve() for folder in (home, file.path.parent)]
    names = [(str(path), Path(str(path))) for path in file.state.files]
    for name, path in names + file.named_files():
        if not any(path.resolve().is_relative_to(folder) for folder in inside):
            raise ValueError(
                f"{file.path} names {name}, which lies outside of the scene's folder; a scene that is rendered by a "
                "cluster may name what is in its own folder alone. Copy the file there."
            )
        if (name, path) not in names and os.path.isabs(name):
            raise ValueError(
                f"{file.path} names {name} by its place on this machine; a scene that is rendered by a cluster names "
                "its files from its own folder on."
            )
        place = Path(os.path.abspath(path))
        if (name, path) not in names and not place.is_relative_to(home):
            place = Path(os.path.abspath(home / name))
        yield place, path
