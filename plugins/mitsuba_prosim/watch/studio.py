"""The one thread that renders what is wished."""

from __future__ import annotations

import gc
import warnings
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import prosim_scene
from prosim_scene import Document

from ..denoising import layers
from ..scene import black, session
from ..scene.errors import pointed, with_nearest
from . import takes
from .board import Board, State
from .camera import Camera
from .denoised import DenoisedTake
from .desk import Desk
from .easel import Easel
from .glimpse import glimpse
from .named import Files
from .picture import Picture
from .subject import Opener, Subject
from .wish import Wish

#: What makes a black picture brighter on the page.
ON_THE_PAGE = "Exposure {} makes it bright here"

#: Where no camera is that is wished.
NOWHERE = Camera(np.eye(4), 1.0, np.array([0.0, 1.0, 0.0]), (1.0, 1.0))


class SupersededError(Exception):
    """Something else is wished than what is being rendered."""


class DroppedError(Exception):
    """The image that is being rendered is compared with no more."""


class Studio:
    """Shows on ``board`` what is wished at ``desk`` of the scene at ``path``, which ``opener`` opens. ``spp``: samples
    per pixel, 0 for what the scene says; ``denoise``: whether the image is denoised in the end.
    """

    def __init__(self, path: Path, opener: Opener, spp: int = 0, seed: int = 0, denoise: bool = False) -> None:
        self.desk, self.board, self.files = Desk(), Board(State(path.name)), Files(path)
        self._path, self._opener = path, opener
        self._spp, self._seed, self._denoise = spp, seed, denoise
        self._easel = Easel(self.board)
        self._integrator: Any = None
        self._view: Camera | None = None  # the scene's own, when it was opened last

    def result(self) -> tuple[State, mi.Bitmap, Any, Any]:
        """The state, the image of the scene's integrator as it is shown, that integrator, and how far it came; for an
        errand.
        """
        picture = self.board.pictures["own"]
        planes = {name: picture.layers["final"][..., k] for k, name in enumerate("RGB")}
        planes |= {f"{name}.Y": values for name, values in picture.layers.items() if values.ndim == 2}
        return self.board.state, layers.of_channels(planes), self._integrator, self._easel.takes["own"].last

    def run(self) -> None:
        """Renders what is wished, until somebody says :meth:`.Desk.leave`."""
        gc.collect()
        gc.freeze()  # what is looked through after each change of the scene is what came since
        try:
            while self._turn():
                pass
        finally:
            self._close()
            self.desk.subject = self._integrator = None
            gc.unfreeze()
            self.board.close()

    def _turn(self) -> bool:
        desk = self.desk
        wish = desk.wait(self._easel.done)
        if desk.left:
            return False
        desk.run_errands()
        try:
            if wish.text != desk.shown.text:
                self._open(wish)
            elif desk.subject is not None:
                if wish.camera is not desk.shown.camera:
                    self._look(wish, desk.subject)
                if self._easel.takes:
                    self._render(wish, desk.subject)
                else:  # its image has failed
                    desk.shown = wish
        except SupersededError:
            self._close()
            desk.shown = replace(desk.shown, camera=NOWHERE)  # who has moved it may have moved it back by now
        except (RuntimeError, TypeError, ValueError, OSError, MemoryError) as error:
            self._fail(error)
        except Exception as error:  # noqa: BLE001 (whatever a scene and the plugins in it do, the next save is awaited)
            self._fail(RuntimeError(f"{type(error).__name__}: {error}"))
        return True

    # ---------------------------------------------------------------- another scene, or from elsewhere

    def _open(self, wish: Wish) -> None:
        """The scene anew."""
        self.desk.shown = replace(self.desk.shown, text=wish.text)
        self._easel.begin()
        self.board.say(doing="opening", saves=wish.text)
        state, pictures = self.board.state, self.board.pictures
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", prosim_scene.SceneWarning)
            try:
                document = self._turn_last(wish)
                subject = Subject(self._path, self._opener, document)
            except BaseException:
                self.board.put_back(state, pictures)
                raise
        gc.collect()
        said = tuple(str(w.message) for w in caught if issubclass(w.category, prosim_scene.SceneWarning))
        self.desk.subject = subject
        self.files.opened(subject.files)
        before, self._view = self._view, subject.home
        if before is None or subject.home is None or (before.to_world != subject.home.to_world).any():
            self.desk.ask(lambda wish: replace(wish, camera=None))  # the text says another view
            wish = replace(wish, camera=None)
        elif wish.camera is not None:
            subject.look(wish.camera)
        self.board.say(warnings=said, size=subject.size, movable=subject.home is not None)
        self._begin(wish, subject)

    def _turn_last(self, wish: Wish) -> Document | None:
        """The text as it is read now, if the last scene is still there, that is to go; where the VIEW alone is another,
        that scene is seen by it until there is the new one.
        """
        # The kernels of an image have all materials in them that there are, those of another scene too.
        last, self.desk.subject = self.desk.subject, None
        if last is None or last.file.document is None:
            return None
        document = last.file.read()
        # What is wrong with the view, or with the file, is said where the scene is opened.
        with suppress(Exception):
            seen = glimpse(last, document, wish.camera)
            if seen is not None:
                take, size = seen
                self._easel.first(take, size=size, view=None, black=None, part=0.0, samples=None, noise=None)
        return document

    def _look(self, wish: Wish, subject: Subject) -> None:
        """The scene from elsewhere."""
        assert subject.home is not None
        self.desk.shown = replace(self.desk.shown, camera=wish.camera)
        self._easel.begin()
        subject.look(wish.camera or subject.home)
        self._begin(wish, subject)

    def _begin(self, wish: Wish, subject: Subject) -> None:
        self.desk.shown = replace(wish, compared=False)
        integrator, spp = takes.in_waves(subject.scene.integrator(), subject.sensor, self._spp)
        kind = DenoisedTake if self._denoise else takes.Take
        take = kind(integrator, subject.scene, subject.sensor, spp, self._seed)
        self._easel.takes, self._integrator = {"own": take}, take.integrator
        self.board.say(
            doing="rendering",
            error=None,
            black=None,
            view=subject.view(),
            integrator=takes.name(take.integrator),
            alone=takes.alone(take.integrator),
            compared=wish.compared and takes.alone(take.integrator) is None,
            part=0.0,
            samples=None,
            noise=None,
        )
        if subject.whole:
            with subject.coarse():
                self._easel.first(take)

    # ---------------------------------------------------------------- wave after wave

    def _render(self, wish: Wish, subject: Subject) -> None:
        """Another wave of each image that is not done."""
        desk, easel = self.desk, self._easel
        if wish.compared != desk.shown.compared:
            self._compare(wish.compared)
        desk.shown = replace(desk.shown, stopped=wish.stopped)
        if wish.stopped and not easel.done:
            self.board.say(doing="stopped")
            return
        for name in ("own", "path"):
            self._step(name, subject)
        if easel.done:
            self.board.say(doing="done", part=1.0, **easel.reached())
        else:
            self.board.say(doing="rendering")

    def _step(self, name: str, subject: Subject) -> None:
        """Another wave of an image, where there is one that is not done."""
        easel = self._easel
        if name not in easel.takes:
            return
        try:
            if easel.step(name, self._between):
                why = self._why_black(subject, self.board.pictures[name]) if name == "own" else self.board.state.black
                self.board.say(black=why, **easel.reached())
        except DroppedError:
            self._compare(False)  # who has it no more may want it again by now

    def _compare(self, compared: bool) -> None:
        self.desk.shown = replace(self.desk.shown, compared=compared)
        own = self._easel.takes["own"]
        self._easel.go_on(own=own)
        pictures = self._easel.pictures()  # what another scene's path has come to is none of these
        if compared and takes.alone(own.integrator) is None:
            self._easel.takes["path"] = takes.rival(own)
        self.board.say(pictures, compared="path" in self._easel.takes, part=self._easel.part)

    def _why_black(self, subject: Subject, picture: Picture) -> str | None:
        return black.why(subject.scene, subject.sensor, picture.layers["final"], ON_THE_PAGE)

    def _between(self, name: str) -> None:
        """Between two portions of a wave: errands, a stop, something else to be seen, or more of the same."""
        self._easel.more()
        self.desk.run_errands()
        if self.desk.halted:
            self._easel.show(name)
            self.board.say(doing="stopped")
            self.desk.pause()
            self.board.say(doing="rendering")
        if self.desk.superseded:
            raise SupersededError
        if self.desk.compared != self.desk.shown.compared:
            self._compare_between(name)
        self._easel.report(name)

    def _compare_between(self, name: str) -> None:
        """What is compared, or not any more, between two portions of a wave: where that is of the scene's own image, it
        waits while ``path`` has its first wave.
        """
        if name == "path":
            raise DroppedError
        subject, compared = self.desk.subject, self.desk.compared
        if subject is not None and subject.whole:  # within a wave the film has no crop window
            self._compare(compared)
            self._step("path", subject)

    def _close(self) -> None:
        self._easel.takes = {}

    def _fail(self, error: BaseException) -> None:
        self._close()
        missing, words = not self._path.exists(), with_nearest(session.message(error))
        if self.desk.subject is None:
            self.files.failed(words)
        self.board.say(doing="missing" if missing else "failed", error=None if missing else pointed(words, self._path))
