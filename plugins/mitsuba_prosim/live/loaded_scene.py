"""A scene file that is open: its camera moves, and it tells what a pixel shows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from math import ceil, radians, sqrt, tan
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from prosim_scene import Document, Leaf

from .. import compat, registry
from ..scene.scene_file import SceneFile
from .camera import Camera, as_view, as_xml, nearest_axis
from .files import stamp
from .image import ProgressiveImage, progressive

#: Opens the scene, by its text where that has been read already: returns the file, its scene, and the sensor.
Opener = Callable[[Document | None], tuple[SceneFile, Any, Any]]

#: Pixels at most of the picture that comes before the first pass.
COARSE = 1 << 14


class LoadedScene:
    """The scene at ``path``; ``document``: its text, where that has been read already. Raises what ``opener`` does."""

    def __init__(self, path: Path, opener: Opener, document: Document | None = None) -> None:
        self.file, self.scene, self.sensor = opener(document)
        #: The files that it is made of, wherever they lie; without those of its translation.
        self.files = self.file.sources()
        if self.file.document is None:
            self.files += [Path(str(path)) for path in self.file.state.files]
        else:
            made = self.file.xml.parent.resolve()
            self.files = [path for path in self.files if made not in path.resolve().parents]
        self._stamps = {path: stamp(path) for path in self.files}
        film = self.sensor.film()
        self.size = (int(film.crop_size()[0]), int(film.crop_size()[1]))
        #: Whether it has no crop window.
        self.whole = list(film.crop_offset()) == [0, 0] and list(film.crop_size()) == list(film.size())
        self._params = mi.traverse(self.sensor)
        self.home = self._home()
        self.camera = self.home

    # ---------------------------------------------------------------- looking from elsewhere

    def _home(self) -> Camera | None:
        """The scene's own view; None for a sensor that can't be moved."""
        sensor: Any = self.sensor
        window = isinstance(self.sensor, registry.PLUGINS["prosim_window"])
        across: tuple[float, float]
        if sensor.class_name() == compat.PERSPECTIVE:
            width = 2 * tan(radians(float(self._params["x_fov"][0])) / 2)
            across = (width, width * self.size[1] / self.size[0])
            self._near, self._far = float(self._params["near_clip"]), float(self._params["far_clip"])
        elif window:
            across = (sensor.right - sensor.left, sensor.top - sensor.bottom)
            self._near, self._far = float(sensor.near_clip), float(sensor.far_clip)
        else:
            return None
        matrix = compat.world_matrix(sensor)
        lengths = np.linalg.norm(matrix[:3, :3], axis=0)
        if not np.allclose(matrix[:3, :3].T @ matrix[:3, :3], np.eye(3) * lengths**2, atol=1e-3 * lengths.max() ** 2):
            return None  # sheared
        matrix[:3, :3] /= lengths
        return Camera(matrix, self._distance(matrix), nearest_axis(matrix[:3, 1]), across)

    def _distance(self, matrix: np.ndarray) -> float:
        """From the eye to what it looks at: the view plane, or the middle of the scene."""
        if self.file.document is not None:
            view = self.file.document.scene.view
            depth = abs((np.array(view.vrp) - view.eye) @ matrix[:3, 2])
        else:
            box = self.scene.bbox()
            depth = float((np.array(box.center()) - matrix[:3, 3]) @ matrix[:3, 2]) if box.valid() else 0.0
        return float(depth) if depth > 1e-6 else max(10 * self._near, 1e-3)

    def look(self, camera: Camera | None) -> None:
        """Moves the camera; None for the scene's own view."""
        assert self.home is not None
        camera = camera or self.home
        # The planes must not cut off what they did not cut off before.
        moved = float(np.linalg.norm(camera.eye - self.home.eye))
        near = min(self._near, 1e-3 * camera.distance) if moved else self._near
        compat.set_world_transform(self.sensor, self._params, camera.to_world)
        if "near_clip" in self._params:
            self._params["near_clip"], self._params["far_clip"] = near, self._far + moved
        else:
            self.sensor.near_clip, self.sensor.far_clip = near, self._far + moved
        self._params.update()
        self.camera = camera

    def turned(self, document: Document) -> tuple[mi.Sensor, tuple[int, int]] | None:
        """A sensor for the VIEW of ``document`` with a coarse film, and the final size of the picture; None where more
        than that VIEW has changed. Raises :class:`prosim_scene.SceneError` for a view that there can't be.
        """
        before = self.file.document
        if before is None or not self.whole or document.scene.view == before.scene.view:
            return None
        if replace(document.scene, view=before.scene.view) != before.scene:
            return None
        if any(stamp(path) != stamped for path, stamped in self._stamps.items()):
            return None
        sensor = self.file.sensor(document)
        size = sensor["film"]["width"], sensor["film"]["height"]
        sensor["film"] |= dict(zip(("width", "height"), coarser(size)))
        return mi.load_dict(sensor, parallel=False), size

    def view(self) -> str | None:
        """The view as it was moved, as text for the scene; None where it was not."""
        if self.home is None or self.camera is None or self.camera is self.home:
            return None
        if self.file.document is None:
            return as_xml(self.camera)
        return as_view(self.file.document.scene.view, self.home, self.camera)

    @contextmanager
    def coarse(self) -> Iterator[None]:
        """Gives the film fewer pixels for a while; the code of the kernels is the same."""
        before = mi.ScalarVector2u(self.sensor.film().size())
        try:
            self._resize(mi.ScalarVector2u(coarser(self.size)))
            yield
        finally:
            self._resize(before)

    def _resize(self, size: mi.ScalarVector2u) -> None:
        self._params["film.size"], self._params["film.crop_size"] = size, size
        self._params.update()

    # ---------------------------------------------------------------- what is seen where

    def seen(self, x: int, y: int) -> str:
        """The surface in the middle of pixel (x, y), in words."""
        place = mi.Point2f((x + 0.5) / self.size[0], (y + 0.5) / self.size[1])
        ray, _ = self.sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
        si = self.scene.ray_intersect(ray)
        if not bool(si.is_valid()[0]):
            return "background"
        shape = compat.met_shape(self.scene, si)
        return self._words(shape) if shape is not None else "a shape within another"

    def _words(self, shape: mi.Shape) -> str:
        name = shape.id()
        if shape.is_emitter():
            return f"source {name}"
        if self.file.document is None:
            bsdf = shape.bsdf()
            return f"{shape.class_name()} {name}, {bsdf.class_name()} {bsdf.id()}".strip()
        index = int(name.split("_")[1]) if name.startswith("surface_") else -1
        leaves = [leaf for leaf in self.file.document.scene.csg if isinstance(leaf, Leaf) and leaf.index == index]
        kinds = " or ".join(dict.fromkeys(leaf.shape.upper() for leaf in leaves))
        return f"{kinds} {index}, SURFACE {index} (line {self.file.document.line('surfaces', index)})"


def coarser(size: tuple[int, int]) -> tuple[int, int]:
    """Size of the picture that comes before the first pass over one of ``size``."""
    width, height = size
    least = max(1, ceil(sqrt(width * height / COARSE)))
    return max(1, width // least), max(1, height // least)


def preview(
    scene: LoadedScene, document: Document, moved: Camera | None
) -> tuple[ProgressiveImage, tuple[int, int]] | None:
    """The coarse image of ``scene`` by the VIEW of ``document``, until the scene is open again, and its final size.

    None where more than that VIEW has changed, and where the camera is ``moved`` and stays where it is, as the eye
    does. Raises :class:`prosim_scene.SceneError` for a view that there can't be.
    """
    if (turned := scene.turned(document)) is None:
        return None
    sensor, size = turned
    if moved is not None and scene.home is not None and np.allclose(compat.world_matrix(sensor), scene.home.to_world):
        return None
    integrator, spp = progressive(scene.scene.integrator(), sensor, 1)
    return ProgressiveImage(integrator, scene.scene, sensor, spp, 0), size
