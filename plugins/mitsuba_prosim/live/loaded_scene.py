"""Opens a scene file, moves the scene's camera, and finds the name of the surface that is visible at a pixel."""

from math import radians, tan
from typing import Any

import mitsuba as mi
import numpy as np

from .. import compat, registry
from ..explaining.explanation import places
from ..explaining.recorder import shape_names
from ..parameters import pick_sensor
from ..scene.scene_file import SceneFile
from .orbit_camera import Camera, as_view, as_xml, nearest_axis


class LoadedScene:
    """A loaded scene, seen by the sensor with the index ``sensor``.

    Raises the errors of loading plugins, and those of :func:`.pick_sensor`.
    """

    def __init__(self, file: SceneFile, sensor: int = 0) -> None:
        self.file, self.scene = file, file.load()
        self.places = places(file)
        self.sensor = pick_sensor(self.scene, sensor)
        film = self.sensor.film()
        self.size = (int(film.crop_size()[0]), int(film.crop_size()[1]))
        self._params = mi.traverse(self.sensor)
        #: The camera that the scene file describes; None if the sensor cannot be moved.
        self.home = self._home()

    def called(self, shape: Any) -> str:
        """Returns the name of a shape in the scene file, with the line."""
        return self.places.get(shape.id(), (compat.name_of(shape), ""))[0]

    # ---------------------------------------------------------------- the camera

    def _home(self) -> Camera | None:
        """Returns the camera that the scene file describes; None for a sensor that cannot be moved."""
        sensor: Any = self.sensor
        is_window = isinstance(self.sensor, registry.PLUGINS["prosim_window"])
        across: tuple[float, float]
        if sensor.class_name() == compat.PERSPECTIVE:
            width = 2 * tan(radians(float(self._params["x_fov"][0])) / 2)
            across = (width, width * self.size[1] / self.size[0])
            self._near, self._far = float(self._params["near_clip"]), float(self._params["far_clip"])
        elif is_window:
            across = (sensor.right - sensor.left, sensor.top - sensor.bottom)
            self._near, self._far = float(sensor.near_clip), float(sensor.far_clip)
        else:
            return None
        matrix = compat.world_matrix(sensor)
        matrix[:3, :3] /= np.linalg.norm(matrix[:3, :3], axis=0)
        return Camera(matrix, self._pivot_distance(matrix), nearest_axis(matrix[:3, 1]), across)

    def _pivot_distance(self, matrix: np.ndarray) -> float:
        """Returns the distance from the eye to the pivot, about which the camera rotates: a point of the view plane,
        or, in XML, at the depth of the centre of the scene.
        """
        if self.file.document is not None:
            view = self.file.document.scene.view
            depth = abs((np.array(view.vrp) - view.eye) @ matrix[:3, 2])
        else:
            box = self.scene.bbox()
            depth = float((np.array(box.center()) - matrix[:3, 3]) @ matrix[:3, 2]) if box.valid() else 0.0
        return float(depth) if depth > 1e-6 else max(10 * self._near, 1e-3)

    def look(self, camera: Camera | None) -> None:
        """Moves the scene's sensor to ``camera``; None: to :attr:`home`, which must not be None."""
        assert self.home is not None
        camera = camera or self.home
        # The clipping planes must not hide objects that were visible before the camera moved.
        moved = float(np.linalg.norm(camera.eye - self.home.eye))
        near = min(self._near, 1e-3 * camera.distance) if moved else self._near
        compat.set_world_transform(self.sensor, self._params, camera.to_world)
        if "near_clip" in self._params:
            self._params["near_clip"], self._params["far_clip"] = near, self._far + moved
        else:
            self.sensor.near_clip, self.sensor.far_clip = near, self._far + moved
        self._params.update()

    def view_text(self, camera: Camera | None) -> str | None:
        """Returns the text for the scene file of the moved ``camera``: a VIEW statement, or a ``transform`` element in
        XML. None if the camera has not been moved, or cannot be moved.
        """
        if self.home is None or camera is None:
            return None
        document = self.file.document
        if document is None:
            return as_xml(camera)
        return as_view(document.scene.view, self.home, camera, document.source.spellings)

    # ---------------------------------------------------------------- the surface of a pixel

    def surface_at(self, x: int, y: int) -> str:
        """Returns the name and the line of the surface at the centre of pixel (x, y), or "background"."""
        position = mi.Point2f((x + 0.5) / self.size[0], (y + 0.5) / self.size[1])
        ray, _ = self.sensor.sample_ray(0.0, 0.5, position, mi.Point2f(0.5), True)
        si = self.scene.ray_intersect(ray)
        if not bool(si.is_valid()[0]):
            return "background"
        words = {key: line for key, (_, line) in self.places.items()}  # the line has the name, too
        return shape_names(self.scene, words).get(compat.shape_number(si.shape), "a shape without a name")
