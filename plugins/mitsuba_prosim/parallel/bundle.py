"""A scene as it travels to another machine: its text, and the files that it names."""

from __future__ import annotations

import hashlib
import json
import os
import uuid
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mitsuba as mi

from .. import atomic
from ..scene import scene_file

#: Of this process: a worker keeps one scene of each.
SESSION = uuid.uuid4().hex


@dataclass(frozen=True, eq=False)
class SceneBundle:
    """A scene without the contents of its files, which travel beside it.

    ``key`` is the same for scenes of the same content, ``main`` is the name of the XML file, ``changes`` are further
    arguments of :class:`.SceneFile`, ``sensor`` is the number of the sensor. ``contents`` maps the names of the files,
    relative to a common folder, to their bytes; it is empty on a worker.
    """

    key: str
    main: str
    changes: Mapping[str, Any]
    sensor: int
    variant: str
    contents: Mapping[str, bytes] = field(default_factory=dict)
    session: str = SESSION

    @classmethod
    def of(cls, file: scene_file.SceneFile, sensor: int = 0) -> SceneBundle:
        """The bundle of ``file``.

        Raises OSError, and ValueError if the scene names a file by an absolute path or outside of its folder.
        """
        places = dict(_travelling(file))
        root = Path(os.path.commonpath([place.parent for place in places]))
        contents = {place.relative_to(root).as_posix(): path.read_bytes() for place, path in places.items()}
        main = Path(os.path.abspath(file.xml)).relative_to(root).as_posix()
        key = hashlib.sha256(json.dumps([file.digest(), file.changes, sensor], sort_keys=True).encode()).hexdigest()
        return cls(key, main, file.changes, sensor, mi.variant() or "", contents)

    def load(self, contents: Mapping[str, bytes]) -> tuple[mi.Scene, mi.Sensor]:
        """Its scene and its sensor. Raises what their plugins raise."""
        with atomic.scratch() as folder:
            for name, content in contents.items():
                path = folder / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
            scene = scene_file.SceneFile(folder / self.main, folder, **self.changes).load()
            return scene, scene_file.pick_sensor(scene, self.sensor)


def _travelling(file: scene_file.SceneFile) -> Iterator[tuple[Path, Path]]:
    """``(place, path)`` of the files that make a scene; ``place`` is where the text of the scene leads to, from the
    folder of its XML file. Raises ValueError.
    """
    home = Path(os.path.abspath(file.xml.parent))
    inside = [folder.resolve() for folder in (home, file.path.parent)]
    names = [(str(path), Path(str(path))) for path in file.state.files]
    for name, path in names + file.named_files():
        if not any(path.resolve().is_relative_to(folder) for folder in inside):
            raise ValueError(
                f"{file.path}: the scene names {name}, which lies outside of its folder. A cluster renders scenes with "
                "all files in their own folder: copy the file there."
            )
        if (name, path) not in names and os.path.isabs(name):
            raise ValueError(
                f"{file.path}: the scene names {name} by an absolute path. A cluster renders scenes that name their "
                "files relative to their own folder: write the path so."
            )
        place = Path(os.path.abspath(path))
        if (name, path) not in names and not place.is_relative_to(home):
            place = Path(os.path.abspath(home / name))
        yield place, path
