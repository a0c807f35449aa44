"""What a render is of: all that is asked for but where it goes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi

from ..scene_files import opening


@dataclass(frozen=True)
class Job:
    """A scene file, what is changed in it, and which image of it is made; see :class:`.opening.SceneFile`."""

    scene: str
    variant: str
    definitions: Mapping[str, str]
    sensor: int
    seed: int
    #: Samples per pixel, 0 for what the scene says.
    spp: int
    resolution: tuple[int, int] | None
    crop: tuple[int, int, int, int] | None
    samples: int | None
    integrator: Mapping[str, Any]
    language: Mapping[str, Any]
    exposure: float

    def open(self, folder: Path) -> tuple[opening.SceneFile, mi.Scene, mi.Sensor]:
        """The scene file, its scene and its sensor. ``folder``: for translations. Raises what their makers raise."""
        file = opening.SceneFile(
            self.scene,
            folder,
            definitions=self.definitions,
            resolution=self.resolution,
            crop=self.crop,
            samples=self.samples,
            integrator=self.integrator,
            **self.language,
        )
        scene = file.load()
        return file, scene, opening.pick_sensor(scene, self.sensor)
