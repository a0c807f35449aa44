"""Renders the image that the live page requests, and opens the scene again after each change of its files."""

from __future__ import annotations

import asyncio
import gc
import itertools
import time
import warnings
from collections.abc import AsyncIterator, Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from math import isnan
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import mitsuba as mi
import numpy as np
import prosim_scene

from ..explaining import explanation
from ..scene import black, session
from ..scene.channels import of_channels, planes
from ..scene.errors import with_line, with_suggestion
from .loaded_scene import LoadedScene
from .orbit_camera import Camera
from .progressive_image import Factors, Picture, ProgressiveImage
from .scene_watcher import INTERVAL, SceneWatcher


@dataclass(frozen=True)
class State:
    """The state that a page shows."""

    #: The name of the scene's file.
    scene: str
    #: ``opening``, ``rendering``, ``done``, ``missing`` if the file does not exist, or ``failed``.
    status: str = "opening"
    #: How often the viewer has tried to open the file.
    opened: int = 0
    #: The message of the error, if the status is ``failed``.
    error: str | None = None
    #: The translator's warnings about the scene.
    warnings: tuple[str, ...] = ()
    #: Why the picture is black, or None if it is not black.
    black: str | None = None
    #: Final width and height of the picture.
    size: tuple[int, int] = (0, 0)
    #: Number of the newest picture; None before the first.
    picture: int | None = None
    #: Names of the layers of the picture.
    layers: tuple[str, ...] = ()
    #: Ids of shapes and emitters -> their names and lines in the scene file.
    names: Mapping[str, str] = field(default_factory=dict)
    #: Progress of the image, 0 to 1.
    progress: float = 0.0
    #: Samples per pixel and noise (RMS error, white = 1) of the image; None if they are not known.
    samples: float | None = None
    noise: float | None = None
    #: Seconds of rendering.
    seconds: float = 0.0
    #: The text of the moved view for the scene file; None if the camera was not moved.
    view: str | None = None
    #: Whether the camera can be moved.
    movable: bool = False


#: Approximate duration of a work item in seconds. The viewer handles new requests between work items.
SECONDS = 0.4
#: The advice in the message about a black picture; {} is the exposure.
ON_THE_PAGE = "Exposure {} makes it bright here"


class Viewer:
    """Renders and publishes the image that the live page requests, and opens the scene file ``path`` again after each
    change of the scene's files.

    ``open_scene`` loads the scene. ``spp`` is the number of samples per pixel; 0 means that of the scene. Other threads
    than the one that renders may read :attr:`state` and :attr:`picture`, and may use :meth:`latest`, :meth:`follow`,
    :meth:`close` and :meth:`call`, whose functions may use all methods.
    """

    def __init__(
        self, path: Path, open_scene: Callable[[], LoadedScene], spp: int = 0, seed: int = 0, denoise: bool = False
    ) -> None:
        #: The latest state and picture, and whether the viewer was closed.
        self.state, self.picture, self.closed = State(path.name), cast("Picture | None", None), False
        self.watcher = SceneWatcher(path)
        #: The open scene; None if it could not be opened.
        self.scene: LoadedScene | None = None
        self._path, self._open_scene = path, open_scene
        self._spp, self._seed, self._denoise = spp, seed, denoise
        #: The thread that renders, one work item after the other, and the functions of :meth:`call` in between.
        self._thread = ThreadPoolExecutor(1, "render")
        #: The moved camera that the page requests, None for that of the scene file; and the one that is shown.
        self.camera = self._shown = cast("Camera | None", None)
        #: The camera in the scene file that was opened last; None if the viewer cannot move this sensor. A move starts
        #: from this camera.
        self._home: Camera | None = None
        #: The image that is rendered; None after an error.
        self._image: ProgressiveImage | None = None
        #: Samples and noise (:class:`.Reached`) when the image was drawn last; None before its first sample.
        self._reached: Any = None
        #: The numbers of the pictures; the seconds that work items took since the requested view began.
        self._numbers, self._seconds = itertools.count(1), 0.0

    # ---------------------------------------------------------------- requests

    def call(self, work: Callable[[Viewer], Any]) -> Future[Any]:
        """Schedules the short function ``work`` for the thread that renders, between two work items; returns a future
        of its result.
        """
        return self._thread.submit(work, self)

    def close(self) -> None:
        """Ends the thread that renders, and the streams of states that open pages receive."""
        self.closed = True

    async def follow(self) -> AsyncIterator[State]:
        """Yields the current state, and the latest state after each change, until the viewer is closed."""
        last = None
        while not self.closed:
            if self.state is not last:
                yield (last := self.state)
            await asyncio.sleep(INTERVAL)

    def latest(self) -> Picture:
        """Returns the latest picture; raises ValueError if there is none."""
        if self.picture is None:
            raise ValueError("There is no image yet; try again when the page shows one.")
        return self.picture

    def move(self, motion: Callable[[Camera], Camera | None]) -> None:
        """Requests an image from the camera that ``motion`` returns for the current one, if the sensor can be moved;
        None is the camera of the scene file.
        """
        if self._home is not None:
            self.camera = motion(self.camera or self._home)

    def result(self, factors: Factors = MappingProxyType({})) -> tuple[State, mi.Bitmap, ProgressiveImage, Any]:
        """Returns ``(state, bitmap, image, reached)`` of the latest published picture.

        ``bitmap`` has all layers of the picture, multiplied by ``factors``. ``reached`` is a :class:`.Reached`; None
        before the first sample. Raises ValueError if there is no picture, and after an error of the scene.
        """
        picture, image, channels = self.latest(), self._image, dict[str, np.ndarray]()
        if image is None:
            raise ValueError("There is no image; save it when the page shows a new one.")
        for layer, values in picture.mixed(factors).layers.items():
            # The channels of the layer lights.lamp1 are lamp1.R, lamp1.G and lamp1.B; a map has one channel, error.Y.
            prefix = "" if layer == "final" else layer.rpartition(".")[2] + "."
            channels |= planes(prefix, values) if values.ndim == 3 else {prefix + "Y": values}
        return self.state, of_channels(channels), image, self._reached

    def explanation(self, x: int, y: int) -> str:
        """Returns the HTML page that explains the pixel (x, y) of the image.

        Raises the errors of :class:`.Samples`, and ValueError if there is no picture.
        """
        picture, scene = self.latest(), self.scene
        if scene is None:
            raise ValueError("The scene could not be opened; try again when the page shows a new image.")
        seen = {"scene": scene.scene, "sensor": scene.sensor, "image": picture.layers["final"]}
        return explanation.page(scene.file, pixel=(x, y), spp=self._spp, seed=self._seed, **seen)

    def publish(self, picture: Picture | None = None, **changes: Any) -> None:
        """Changes fields of the state, and replaces the picture unless ``picture`` is None."""
        if picture is not None:
            self.picture = picture
            changes |= {"picture": picture.number, "layers": tuple(picture.layers)}
        self.state = replace(self.state, **changes)

    # ---------------------------------------------------------------- rendering the requested image

    def run(self) -> None:
        """Renders the images that the page requests, until another thread calls :meth:`close`."""
        gc.collect()
        gc.freeze()  # later garbage collections then visit only younger objects
        try:
            with self._thread:
                while not self.closed:
                    self._thread.submit(self._advance).result()
                    if self._idle:
                        time.sleep(INTERVAL)
        finally:
            self._image = self.scene = None
            gc.unfreeze()

    @property
    def _done(self) -> bool:
        return self._image is None or self._image.done

    @property
    def _idle(self) -> bool:
        return self.camera is self._shown and self._done

    def _advance(self) -> None:
        """Does the next piece of work for the current request, if there is any."""
        try:
            if not self.state.opened or self.watcher.changed():
                self._open()
            elif self.scene is None:  # the scene could not be opened
                self._shown = self.camera
            elif self.camera is not self._shown:
                self.scene.look(self.camera)
                self._begin(self.scene)
            elif self._image is not None and not self._idle:
                self._step(self.scene, self._image)
        except Exception as error:  # noqa: BLE001 (after any error of a scene, the viewer waits for the next change)
            self._fail(error)

    # ---------------------------------------------------------------- a new scene or view

    def _open(self) -> None:
        """Opens the scene file, and begins to render.

        A camera that the user has moved stays there, unless the file describes another view than before.
        """
        # Dr.Jit's kernels contain the materials of all loaded scenes, so the previous scene must be deleted first.
        self.scene = self._image = None
        self.publish(status="opening", opened=self.state.opened + 1)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", prosim_scene.SceneWarning)
            scene = self._open_scene()
        gc.collect()
        messages = tuple(str(w.message) for w in caught if issubclass(w.category, prosim_scene.SceneWarning))
        self.watcher.opened(scene.file.sources())
        previous_home, self._home, self.scene = self._home, scene.home, scene
        if previous_home is None or scene.home is None or (previous_home.to_world != scene.home.to_world).any():
            self.camera = None  # the scene file has a new view
        elif self.camera is not None:
            scene.look(self.camera)
        names = {key: name for key, (name, _) in scene.places.items()}
        self.publish(warnings=messages, size=scene.size, movable=scene.home is not None, names=names)
        self._begin(scene)

    def _begin(self, scene: LoadedScene) -> None:
        """Begins a new render of the requested view, with a coarse image first."""
        self._shown = self.camera
        self._reached, self._seconds = None, 0.0
        integrator = scene.scene.integrator()
        image = ProgressiveImage(integrator, scene.scene, scene.sensor, self._spp, self._seed, self._denoise)
        self._image, image.executor.seconds = image, SECONDS
        self._publish(image, error=None, black=None, view=scene.view_text(self.camera))
        image.begin_coarse()
        self._draw(image)
        self._publish(image)

    # ---------------------------------------------------------------- work item after work item

    def _step(self, scene: LoadedScene, image: ProgressiveImage) -> None:
        """Renders one work item."""
        started, changes = time.perf_counter(), dict[str, Any]()
        if image.step():
            self._draw(image)
        if image.complete and image.picture is not None:
            final = image.picture.layers["final"]
            changes["black"] = black.reason(scene.scene, scene.sensor, final, ON_THE_PAGE, called=scene.called)
        self._seconds += time.perf_counter() - started
        self._publish(image, **changes)

    def _draw(self, image: ProgressiveImage) -> None:
        with image.throttle.drawing():
            image.picture = Picture(next(self._numbers), image.layers())
            if image.render is not None:
                self._reached = image.reached

    def _publish(self, image: ProgressiveImage, **changes: Any) -> None:
        """Publishes the picture and the progress of ``image``, and the other ``changes`` of the state. Before the first
        picture of an image, the previous picture remains.
        """
        reached = self._reached
        self.publish(
            image.picture,
            status="done" if self._done else "rendering",
            progress=image.progress,
            samples=reached.samples if reached else None,
            noise=None if reached is None or isnan(reached.noise) else reached.noise,
            seconds=self._seconds,
            **changes,
        )

    def _fail(self, error: BaseException) -> None:
        """Publishes an error, and ends the render until the scene's files or the view change."""
        self._image, self._shown = None, self.camera
        expected = isinstance(error, (RuntimeError, TypeError, ValueError, OSError, MemoryError))
        words = with_suggestion(session.message(error)) if expected else f"{type(error).__name__}: {error}"
        missing = not self._path.exists()
        if self.scene is None:
            self.watcher.failed()
        status, shown = ("missing", None) if missing else ("failed", with_line(words, self._path))
        self.publish(status=status, error=shown)
