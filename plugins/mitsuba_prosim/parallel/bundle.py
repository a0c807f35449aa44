"""A scene in a form that can be sent to a worker: the text of the scene, and the files that the text names."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi

from .. import atomic
from ..scene import scene_file


@dataclass(frozen=True)
class SceneBundle:
    """A scene in a form that can be sent to a :mod:`.worker`.

    ``main`` is the name of the scene's XML file, ``changes`` are further arguments of :class:`.SceneFile`, and
    ``contents`` maps the name of each file, relative to the scene's folder, to its bytes. Bundles in two variants are
    different, so that a worker loads the scene again.
    """

    main: str
    changes: Mapping[str, Any]
    sensor: int
    variant: str
    contents: Mapping[str, bytes]

    @classmethod
    def of(cls, file: scene_file.SceneFile, sensor: int = 0) -> SceneBundle:
        """Returns the bundle of the scene ``file``.

        Raises OSError if a file cannot be read. Raises ValueError if the scene names a file outside the scene's folder,
        or by an absolute path.
        """
        folders, contents = [Path(os.path.abspath(folder)) for folder in (file.xml.parent, file.path.parent)], {}
        for name, path in file.named_files():
            place = Path(os.path.abspath(path))
            folder = next((folder for folder in folders if place.is_relative_to(folder)), None)
            if folder is None or os.path.isabs(name):
                raise ValueError(
                    f"{file.path}: the scene names {name}, and a cluster needs all files in the scene's folder; copy "
                    "the file there, and name it relative to that folder"
                )
            contents[place.relative_to(folder).as_posix()] = path.read_bytes()
        return cls(file.xml.name, file.changes, sensor, mi.variant() or "", contents)

    def load(self) -> tuple[mi.Scene, mi.Sensor]:
        """Writes the files to a temporary folder, and returns the scene and its sensor. Raises the errors of
        :class:`.SceneFile` and of the plugins.
        """
        with atomic.scratch() as folder:
            atomic.write({folder / name: content for name, content in self.contents.items()})
            scene = scene_file.SceneFile(folder / self.main, folder, **self.changes).load()
            return scene, scene_file.pick_sensor(scene, self.sensor)
