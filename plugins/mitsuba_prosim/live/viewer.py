"""The thread that renders the requested image."""

from __future__ import annotations

import gc
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from math import isnan
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import prosim_scene

from ..denoising import layers
from ..scene import black, session
from ..scene.errors import with_line, with_suggestion
from .loaded_scene import LoadedScene
from .picture import Factors, Picture
from .progressive_image import ProgressiveImage, by_path, name, not_compared, progressive
from .publisher import Publisher, State, Throttle
from .scene_watcher import SceneWatcher
from .view_requests import ViewRequest, ViewRequests

#: How to make a black picture brighter on the page.
ON_THE_PAGE = "Exposure {} makes it bright here"


class Viewer:
    """Renders and publishes the image that :attr:`requests` ask for, of the scene at ``path``.

    ``open_scene`` loads it. ``spp``: samples per pixel, 0 for those of the scene; ``denoise``: whether the final image
    is denoised.
    """

    def __init__(
        self, path: Path, open_scene: Callable[[], LoadedScene], spp: int = 0, seed: int = 0, denoise: bool = False
    ) -> None:
        self.requests, self.publisher, self.watcher = ViewRequests(), Publisher(State(path.name)), SceneWatcher(path)
        self._path, self._open_scene = path, open_scene
        self._spp, self._seed, self._denoise = spp, seed, denoise
        self._scene: LoadedScene | None = None
        #: The request that is shown or being rendered.
        self._shown = ViewRequest(saves=-1)
        #: By name: ``own``, that of the scene's integrator, and maybe ``path``.
        self._images: dict[str, ProgressiveImage] = {}
        self._integrator: Any = None
        self._reached: Any = None
        self._throttle = Throttle()
        self._pictures, self._seconds = 0, 0.0

    def result(self, factors: Factors = ()) -> tuple[State, mi.Bitmap, Any, Any]:
        """The state, the image of the scene's integrator as it is shown, mixed with ``factors``, that integrator, and
        its samples, noise and time; for :meth:`.ViewRequests.call`.
        """
        picture = self.publisher.pictures["own"].mixed(factors)
        planes = {name: picture.layers["final"][..., k] for k, name in enumerate("RGB")}
        planes |= {f"{name}.Y": values for name, values in picture.layers.items() if values.ndim == 2}
        for part in filter(lambda layer: "." in layer, picture.layers):
            planes |= {f"{part.partition('.')[2]}.{c}": picture.layers[part][..., k] for k, c in enumerate("RGB")}
        return self.publisher.state, layers.of_channels(planes), self._integrator, self._reached

    def run(self) -> None:
        """Renders until :meth:`.ViewRequests.close`."""
        gc.collect()
        gc.freeze()  # collections after each change of the scene then visit only younger objects
        try:
            while True:
                request = self.requests.wait(self._idle)
                if self.requests.closed:
                    return
                self.requests.run_calls(self._scene)
                try:
                    self._serve(request)
                except Exception as error:  # noqa: BLE001 (whatever a scene and its plugins do, the next save is awaited)
                    self._fail(request, error)
        finally:
            self._images, self._scene, self._integrator = {}, None, None
            gc.unfreeze()
            self.publisher.closed = True

    def _idle(self, request: ViewRequest) -> bool:
        if request != self._shown:
            return self._scene is None and request.saves == self._shown.saves
        return request.paused or self._done()

    def _done(self) -> bool:
        return all(image.done for image in self._images.values())

    def _serve(self, request: ViewRequest) -> None:
        """Takes the next step towards a request."""
        if request.saves != self._shown.saves:
            self._open(request)
        elif self._scene is None or request == self._shown:
            self._step()
        elif request.camera is not self._shown.camera:
            self._scene.look(request.camera)
            self._begin(request, self._scene)
        else:
            self._pause_or_compare(request)

    # ---------------------------------------------------------------- a new scene or view

    def _open(self, request: ViewRequest) -> None:
        """Opens the scene again."""
        # Kernels contain the materials of all loaded scenes, so the last scene must be deleted first.
        self._scene, self._images = None, {}
        self._shown, self._seconds = replace(self._shown, saves=request.saves), 0.0
        self.publisher.publish(status="opening", saves=request.saves)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", prosim_scene.SceneWarning)
            scene = self._open_scene()
        gc.collect()
        messages = tuple(str(w.message) for w in caught if issubclass(w.category, prosim_scene.SceneWarning))
        self.watcher.opened(scene.files)
        before, self.requests.home, self._scene = self.requests.home, scene.home, scene
        if before is None or scene.home is None or (before.to_world != scene.home.to_world).any():
            self.requests.change(camera=None)  # the text has another view
            request = replace(request, camera=None)
        elif request.camera is not None:
            scene.look(request.camera)
        self.publisher.publish(warnings=messages, size=scene.size, movable=scene.home is not None)
        self._begin(request, scene)

    def _begin(self, request: ViewRequest, scene: LoadedScene) -> None:
        """Begins the image of the scene."""
        self._seconds = 0.0
        self._integrator, spp = progressive(scene.scene.integrator(), scene.sensor, self._spp)
        image = ProgressiveImage(self._integrator, scene.scene, scene.sensor, spp, self._seed, self._denoise)
        self._images = {"own": image}
        reason = not_compared(self._integrator)
        self.publisher.publish(
            status="rendering",
            error=None,
            black=None,
            view=scene.view(),
            integrator=name(self._integrator),
            not_compared=reason,
            compared=request.compared and reason is None,
            progress=0.0,
            samples=None,
            noise=None,
        )
        if scene.whole:
            with scene.coarse(), self._throttle.drawing():
                self._show(image, image.coarse())
        self._shown = replace(request, compared=False, paused=False)

    def _pause_or_compare(self, request: ViewRequest) -> None:
        if self._images and request.compared != self._shown.compared:
            own = self._images["own"]
            self._images = {"own": own}
            if request.compared and not_compared(own.integrator) is None:
                self._images = {"path": by_path(own), "own": own}
            self._publish(compared="path" in self._images, progress=self._progress)
        if self._images and self._done():
            self.publisher.publish(status="done", progress=1.0)
        elif self._images:
            if request.paused:
                for image in self._images.values():
                    self._draw(image)
            self.publisher.publish(status="paused" if request.paused else "rendering")
        self._shown = request

    # ---------------------------------------------------------------- work item after work item

    def _step(self) -> None:
        """Renders a work item of the image that has waited longest."""
        if self._shown.paused or self._done() or self._scene is None:
            return
        started = time.perf_counter()
        which, image = next((name, image) for name, image in self._images.items() if not image.done)
        complete = image.step()
        self._images[which] = self._images.pop(which)  # the last from now on
        if image.new and (complete or self._throttle.due):
            self._draw(image)
        if complete and which == "own" and image.picture is not None:
            why = black.reason(self._scene.scene, self._scene.sensor, image.picture.layers["final"], ON_THE_PAGE)
            self.publisher.publish(black=why)
        self._seconds += time.perf_counter() - started
        status = "done" if self._done() else "rendering"
        self.publisher.publish(status=status, progress=self._progress, seconds=self._seconds)

    @property
    def _progress(self) -> float:
        return sum(image.progress for image in self._images.values()) / len(self._images)

    def _draw(self, image: ProgressiveImage) -> None:
        """Publishes the image so far."""
        with self._throttle.drawing():
            latest = image.layers()
            if latest is None:
                return
            changes: dict[str, Any] = {}
            if image is self._images["own"]:
                self._reached = reached = image.render.reached
                changes = {"samples": reached.samples, "noise": None if isnan(reached.noise) else reached.noise}
            self._show(image, latest, **changes)

    def _show(self, image: ProgressiveImage, layers: Mapping[str, np.ndarray], **changes: Any) -> None:
        """Publishes ``layers`` as a new picture of ``image``, and changes of the state."""
        self._pictures += 1
        image.picture = Picture(self._pictures, layers)
        self._publish(**changes)

    def _publish(self, **changes: Any) -> None:
        """Publishes the pictures, and changes of the state."""
        pictures = {name: image.picture for name, image in self._images.items() if image.picture is not None}
        self.publisher.publish(pictures if "own" in pictures else None, seconds=self._seconds, **changes)

    def _fail(self, request: ViewRequest, error: BaseException) -> None:
        self._images, self._shown = {}, request
        expected = isinstance(error, (RuntimeError, TypeError, ValueError, OSError, MemoryError))
        words = with_suggestion(session.message(error)) if expected else f"{type(error).__name__}: {error}"
        missing = not self._path.exists()
        if self._scene is None:
            self.watcher.failed()
        self.publisher.publish(
            status="missing" if missing else "failed", error=None if missing else with_line(words, self._path)
        )
