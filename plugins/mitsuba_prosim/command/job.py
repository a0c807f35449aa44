"""What a render is of: all that is asked for but where it goes."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import mitsuba as mi
from prosim_scene import Document, Kept

from ..engine.record import Record
from ..scene import scene_file


@dataclass(frozen=True)
class Job:
    """A scene file, what is changed in it, and which image of it is made; see :class:`.scene_file.SceneFile`."""

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

    @classmethod
    def of(cls, record: Record) -> Job:
        """The job that a record is of. Raises ValueError where it is of none."""
        try:
            said = dict(record.about["job"])
            tuples = {name: said[name] and tuple(said[name]) for name in ("resolution", "crop")}
            return cls(**(said | tuples))
        except (KeyError, TypeError):
            raise ValueError(
                "this state was not kept by prosim render, so the command can't know what it is of; go on with it "
                "where it comes from, by integrator.waves(begin=...)"
            ) from None

    def about(self, file: scene_file.SceneFile) -> dict[str, Any]:
        """What a record of it has to say, so that another process can go on: ``job`` and ``digest``."""
        return {"job": asdict(replace(self, scene=os.path.abspath(self.scene))), "digest": file.digest()}

    def file(
        self, folder: Path, kept: Kept | None = None, confined: bool = False, document: Document | None = None
    ) -> scene_file.SceneFile:
        """The scene file. ``folder``: for translations; ``kept``: what they leave to each other; ``confined``: whether
        it can name no file outside its own folder; ``document``: what the text says, where it has been read already.
        Raises what its maker raises.
        """
        return scene_file.SceneFile(
            self.scene,
            folder,
            definitions=self.definitions,
            resolution=self.resolution,
            crop=self.crop,
            samples=self.samples,
            integrator=self.integrator,
            kept=kept,
            confined=confined,
            document=document,
            **self.language,
        )

    def open(
        self, folder: Path, kept: Kept | None = None, confined: bool = False, document: Document | None = None
    ) -> tuple[scene_file.SceneFile, mi.Scene, mi.Sensor]:
        """The scene file, its scene and its sensor; see :meth:`file`. Raises what their makers raise."""
        file = self.file(folder, kept, confined, document)
        scene = file.load()
        return file, scene, scene_file.pick_sensor(scene, self.sensor)
