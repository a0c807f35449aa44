"""The thread that renders the requested image."""

from __future__ import annotations

import gc
import time
import warnings
from dataclasses import replace
from math import isnan
from pathlib import Path
from typing import Any

import mitsuba as mi
import prosim_scene

from ..denoising import layers
from ..scene import black, session
from ..scene.errors import pointed, with_nearest
from .camera import Camera
from .files import Files
from .image import DenoisedImage, ProgressiveImage, by_path, name, not_compared, progressive
from .loaded_scene import LoadedScene, Opener
from .picture import Picture
from .publisher import Publisher, State
from .requests import Request, Requests
from .throttle import Throttle

#: How to make a black picture brighter on the page.
ON_THE_PAGE = "Exposure {} makes it bright here"

#: Seconds between two reports of progress.
REPORT = 0.1


class Viewer:
    """Renders and publishes the image that :attr:`requests` ask for, of the scene at ``path``, which ``opener`` opens.

    ``spp``: samples per pixel, 0 for those of the scene; ``denoise``: whether the final image is denoised.
    """

    def __init__(self, path: Path, opener: Opener, spp: int = 0, seed: int = 0, denoise: bool = False) -> None:
        self.requests, self.publisher, self.files = Requests(), Publisher(State(path.name)), Files(path)
        self._path, self._opener = path, opener
        self._spp, self._seed, self._kind = spp, seed, DenoisedImage if denoise else ProgressiveImage
        self._scene: LoadedScene | None = None
        self._home: Camera | None = None  # the view of the scene that was opened last
        #: The request that is shown or being rendered.
        self._shown = Request(saves=-1)
        #: By name: ``own``, that of the scene's integrator, and maybe ``path``; and their pictures so far.
        self._images: dict[str, ProgressiveImage] = {}
        self._pictures: dict[str, Picture] = {}
        self._integrator: Any = None
        self._reached: Any = None
        self._throttle = Throttle()
        self._number, self._seconds, self._reported = 0, 0.0, 0.0

    def result(self) -> tuple[State, mi.Bitmap, Any, Any]:
        """The state, the image of the scene's integrator as it is shown, that integrator, and its samples, noise and
        time; for :meth:`.Requests.call`.
        """
        picture = self.publisher.pictures["own"]
        planes = {name: picture.layers["final"][..., k] for k, name in enumerate("RGB")}
        planes |= {f"{name}.Y": values for name, values in picture.layers.items() if values.ndim == 2}
        return self.publisher.state, layers.of_channels(planes), self._integrator, self._reached

    def run(self) -> None:
        """Renders until :meth:`.Requests.close`."""
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

    def _idle(self, request: Request) -> bool:
        if request != self._shown:
            return self._scene is None and request.saves == self._shown.saves
        return request.stopped or self._done()

    def _done(self) -> bool:
        return all(image.done for image in self._images.values())

    def _serve(self, request: Request) -> None:
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

    def _open(self, request: Request) -> None:
        """Opens the scene again."""
        # Kernels contain the materials of all loaded scenes, so the last scene has to go.
        self._scene, self._images, self.requests.home = None, {}, None
        self._shown, self._seconds = replace(self._shown, saves=request.saves), 0.0
        self.publisher.publish(doing="opening", saves=request.saves)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", prosim_scene.SceneWarning)
            scene = LoadedScene(self._opener)
        gc.collect()
        messages = tuple(str(w.message) for w in caught if issubclass(w.category, prosim_scene.SceneWarning))
        self.files.opened(scene.files)
        self._scene, home, self._home, self.requests.home = scene, self._home, scene.home, scene.home
        if home is None or scene.home is None or (home.to_world != scene.home.to_world).any():
            self.requests.change(camera=None)  # the text has another view
            request = replace(request, camera=None)
        elif request.camera is not None:
            scene.look(request.camera)
        self.publisher.publish(warnings=messages, size=scene.size, movable=scene.home is not None)
        self._begin(request, scene)

    def _begin(self, request: Request, scene: LoadedScene) -> None:
        """Begins the image of the scene."""
        self._images, self._pictures, self._seconds = {}, {}, 0.0
        self._integrator, spp = progressive(scene.scene.integrator(), scene.sensor, self._spp)
        image = self._kind(self._integrator, scene.scene, scene.sensor, spp, self._seed)
        alone = not_compared(self._integrator)
        self.publisher.publish(
            doing="rendering",
            error=None,
            black=None,
            view=scene.view(),
            integrator=name(self._integrator),
            alone=alone,
            compared=request.compared and alone is None,
            part=0.0,
            samples=None,
            noise=None,
        )
        if scene.whole:
            with scene.coarse():
                self._show_coarse(image)
        self._images = {"own": image}
        self._shown = replace(request, compared=False, stopped=False)

    def _pause_or_compare(self, request: Request) -> None:
        if self._images and request.compared != self._shown.compared:
            own = self._images["own"]
            self._images = {"own": own}
            self._pictures = {name: picture for name, picture in self._pictures.items() if name == "own"}
            if request.compared and not_compared(own.integrator) is None:
                self._images = {"path": by_path(own), "own": own}
            self.publisher.publish(self._pictures or None, compared="path" in self._images, part=self._part)
        if self._images and self._done():
            self.publisher.publish(doing="done", part=1.0)
        elif self._images:
            if request.stopped:
                for which in self._images:
                    self._show(which)
            self.publisher.publish(doing="stopped" if request.stopped else "rendering")
        self._shown = request

    # ---------------------------------------------------------------- work item after work item

    def _step(self) -> None:
        """Renders a work item of the image that has waited longest."""
        if self._shown.stopped or self._done() or self._scene is None:
            return
        started = time.perf_counter()
        which = next(name for name, image in self._images.items() if not image.done)
        image = self._images[which]
        complete = image.step()
        self._images[which] = self._images.pop(which)  # the last from now on
        if image.new and (complete or (self._throttle and self.publisher.readers)):
            self._show(which)
        if complete and which == "own":
            final = self._pictures["own"].layers["final"]
            why = black.why(self._scene.scene, self._scene.sensor, final, ON_THE_PAGE)
            self.publisher.publish(black=why)
        self._seconds += time.perf_counter() - started
        if self._done():
            self.publisher.publish(doing="done", part=1.0, seconds=self._seconds)
        elif started - self._reported > REPORT:
            self._reported = started
            self.publisher.publish(part=self._part, seconds=self._seconds)

    @property
    def _part(self) -> float:
        return sum(image.part for image in self._images.values()) / len(self._images)

    def _show(self, which: str) -> None:
        """Publishes an image as it is now."""
        with self._throttle.drawing():
            image = self._images[which]
            if image.render is None or (found := image.layers()) is None:
                return
            self._pictures[which] = self._picture(found)
            measured: dict[str, Any] = {}
            if which == "own":
                self._reached = reached = image.reached()
                measured = {"samples": reached.samples, "noise": None if isnan(reached.noise) else reached.noise}
            if "own" in self._pictures:
                shown = tuple(self._pictures["own"].layers)
                self.publisher.publish(self._pictures, layers=shown, seconds=self._seconds, **measured)

    def _show_coarse(self, image: ProgressiveImage) -> None:
        """Publishes the coarse image, before the first pass."""
        with self._throttle.drawing():
            self._pictures = {"own": self._picture({"final": image.coarse()})}
            self.publisher.publish(self._pictures, layers=("final",), seconds=self._seconds)

    def _picture(self, found: Any) -> Picture:
        self._number += 1
        return Picture(self._number, found)

    def _fail(self, request: Request, error: BaseException) -> None:
        self._images, self._shown = {}, request
        expected = isinstance(error, (RuntimeError, TypeError, ValueError, OSError, MemoryError))
        words = with_nearest(session.message(error)) if expected else f"{type(error).__name__}: {error}"
        missing = not self._path.exists()
        if self._scene is None:
            self.files.failed(words)
        self.publisher.publish(
            doing="missing" if missing else "failed", error=None if missing else pointed(words, self._path)
        )
