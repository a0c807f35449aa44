"""The one thread that renders, and what it is wished to show."""

from __future__ import annotations

import gc
import threading
import time
import warnings
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import prosim_scene
from prosim_scene.language.document import Document

from ..denoising import layers
from ..rendering.snapshot import Snapshot
from ..scene_files import black, session
from ..scene_files.pointing import pointed
from . import takes
from .board import Board, State
from .camera import Camera
from .denoised import DenoisedTake
from .glimpse import glimpse
from .named import Files
from .picture import Picture, of_snapshot
from .subject import Opener, Subject
from .wish import Wish

#: What makes a black picture brighter on the page.
ON_THE_PAGE = "Exposure {} makes it bright here"

#: Seconds between two reports of the part that is done.
REPORT = 0.1


class SupersededError(Exception):
    """Something else is wished than what is being rendered."""


class Studio:
    """Shows the scene at ``path``, which ``opener`` opens, on ``board``; its methods but :meth:`run` may be called by
    any thread. ``spp``: samples per pixel, 0 for what the scene says; ``denoise``: whether the image is denoised in the
    end.
    """

    def __init__(self, path: Path, opener: Opener, spp: int = 0, seed: int = 0, denoise: bool = False) -> None:
        self.board, self.files = Board(State(path.name)), Files(path)
        self._path, self._opener = path, opener
        self._spp, self._seed, self._denoise = spp, seed, denoise
        self._changed = threading.Condition()
        self._wish, self._shown = Wish(), Wish(text=-1)
        self._errands: list[tuple[Callable[[], Any], Future[Any]]] = []
        self._left = False
        self._number, self._reported, self._begun = 0, 0.0, 0.0
        self._subject: Subject | None = None
        self._takes: dict[str, takes.Take] = {}
        self._integrator: Any = None
        self._view: Camera | None = None  # the scene's own, when it was opened last

    # ---------------------------------------------------------------- wishes

    def saved(self) -> None:
        """The scene's file has changed."""
        self._ask(lambda wish: replace(wish, text=wish.text + 1, stopped=False))

    def move(self, by: Callable[[Camera], Camera]) -> None:
        """Moves the camera."""
        subject = self._subject
        home = subject.home if subject is not None else None
        if home is not None:
            self._ask(lambda wish: replace(wish, camera=by(wish.camera or home), stopped=False))

    def home(self) -> None:
        """Goes back to the scene's own view."""
        self._ask(lambda wish: replace(wish, camera=None, stopped=False))

    def compare(self, compared: bool) -> None:
        """Whether the image of ``path`` is rendered, too."""
        self._ask(lambda wish: replace(wish, compared=compared))

    def stop(self, stopped: bool = True) -> None:
        """Stops, or goes on."""
        self._ask(lambda wish: replace(wish, stopped=stopped))

    def leave(self) -> None:
        """Ends :meth:`run`."""
        self._left = True
        self._ask(lambda wish: wish)

    def _ask(self, change: Callable[[Wish], Wish]) -> None:
        with self._changed:
            self._wish = change(self._wish)
            self._changed.notify_all()

    def errand(self, work: Callable[[Subject | None], Any]) -> Future[Any]:
        """Has the thread that renders do some short work as soon as it can; with the scene, if one is open."""
        future: Future[Any] = Future()
        with self._changed:
            self._errands.append((lambda: work(self._subject), future))
            self._changed.notify_all()
        return future

    def result(self) -> tuple[State, mi.Bitmap, Any]:
        """The state, the image of the scene's integrator as it is shown, and that integrator; for an errand."""
        picture = self.board.pictures["own"]
        planes = {name: picture.layers["final"][..., k] for k, name in enumerate("RGB")}
        planes |= {f"{name}.Y": values for name, values in picture.layers.items() if values.ndim == 2}
        return self.board.state, layers.of_channels(planes), self._integrator

    # ---------------------------------------------------------------- the thread that renders

    def run(self) -> None:
        """Renders what is wished, until somebody says :meth:`leave`."""
        gc.collect()
        gc.freeze()  # what is looked through after each change of the scene is what came since
        try:
            while self._turn():
                pass
        finally:
            self._close()
            self._subject = self._integrator = None
            gc.unfreeze()
            self.board.close()

    def _turn(self) -> bool:
        with self._changed:
            self._changed.wait_for(self._has_work)
            wish = self._wish
        if self._left:
            return False
        self._run_errands()
        try:
            if wish.text != self._shown.text:
                self._open(wish)
            elif self._subject is not None:
                if wish.camera is not self._shown.camera:
                    self._look(wish)
                self._render(wish)
        except SupersededError:
            self._close()
        except (RuntimeError, TypeError, ValueError, OSError, MemoryError) as error:
            self._fail(error)
        return True

    def _has_work(self) -> bool:
        wish, shown = self._wish, self._shown
        if self._left or self._errands or wish.text != shown.text:
            return True
        if self._subject is None:
            return False
        return (
            wish.camera is not shown.camera
            or wish.compared != shown.compared
            or wish.stopped != shown.stopped
            or (not wish.stopped and not self._all_done())
        )

    def _all_done(self) -> bool:
        return all(take.done for take in self._takes.values())

    def _halted(self) -> bool:
        return self._wish.stopped and not self._superseded()

    def _superseded(self) -> bool:
        wish, shown = self._wish, self._shown
        return self._left or wish.text != shown.text or wish.camera is not shown.camera

    def _run_errands(self) -> None:
        with self._changed:
            errands, self._errands = self._errands, []
        for work, future in errands:
            try:
                future.set_result(work())
            except Exception as error:  # noqa: BLE001 (whoever has sent it is told)
                future.set_exception(error)

    def _open(self, wish: Wish) -> None:
        """The scene anew."""
        self._shown = replace(self._shown, text=wish.text)
        self._begun = time.perf_counter()
        self._close()
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
        self._subject = subject
        self.files.opened(subject.files)
        before, self._view = self._view, subject.home
        if before is None or subject.home is None or (before.to_world != subject.home.to_world).any():
            with self._changed:  # the text says another view
                self._wish = replace(self._wish, camera=None)
            wish = replace(wish, camera=None)
        elif wish.camera is not None:
            subject.look(wish.camera)
        self.board.say(warnings=said, size=subject.size, movable=subject.home is not None)
        self._begin(wish)

    def _turn_last(self, wish: Wish) -> Document | None:
        """The text as it is read now, if the last scene is still there, that is to go; where the VIEW alone is another,
        that scene is seen by it until there is the new one.
        """
        # The kernels of an image have all materials in them that there are, those of another scene too.
        last, self._subject = self._subject, None
        if last is None or last.file.document is None:
            return None
        document = last.file.read()
        seen = glimpse(last, document, wish.camera)
        if seen is not None:
            take, size = seen
            self._show(take.first(), size=size, view=None, black=None, part=0.0, samples=None, noise=None)
        return document

    def _show(self, first: Snapshot, **said: Any) -> None:
        """The picture that comes before the first wave."""
        picture = Picture(self._next_number(), {"final": of_snapshot(first)["final"]})
        self.board.say({"own": picture}, layers=("final",), seconds=time.perf_counter() - self._begun, **said)

    def _look(self, wish: Wish) -> None:
        """The scene from elsewhere."""
        assert self._subject is not None and self._subject.home is not None
        self._begun = time.perf_counter()
        self._close()
        self._subject.look(wish.camera or self._subject.home)
        self._begin(wish)

    def _begin(self, wish: Wish) -> None:
        assert self._subject is not None
        self._shown = replace(wish, compared=False)
        subject = self._subject
        integrator, spp = takes.in_waves(subject.scene.integrator(), subject.sensor, self._spp)
        kind = DenoisedTake if self._denoise else takes.Take
        take = kind(integrator, subject.scene, subject.sensor, spp, self._seed)
        self._takes, self._integrator = {"own": take}, take.integrator
        self.board.say(
            doing="rendering",
            error=None,
            black=None,
            view=self._subject.view(),
            integrator=takes.name(take.integrator),
            alone=takes.alone(take.integrator),
            compared=wish.compared and takes.alone(take.integrator) is None,
            part=0.0,
            samples=None,
            noise=None,
        )
        if self._subject.whole:
            with self._subject.coarse():
                self._show(take.first())

    def _render(self, wish: Wish) -> None:
        """Another wave of each image that is not done."""
        assert self._subject is not None
        if wish.compared != self._shown.compared:
            self._compare(self._subject, wish.compared)
        self._shown = replace(self._shown, stopped=wish.stopped)
        if wish.stopped and not self._all_done():
            self.board.say(doing="stopped")
            return
        for name, take in list(self._takes.items()):
            if take.done or not take.step(self._between):
                continue
            picture = Picture(self._next_number(), take.layers())
            said = {"black": self._why_black(picture)} if name == "own" else {}
            pictures = {n: p for n, p in self.board.pictures.items() if n in self._takes} | {name: picture}
            self.board.say(
                pictures,
                layers=tuple(pictures["own"].layers),
                seconds=time.perf_counter() - self._begun,
                **self._reached(),
                **said,
            )
        if self._all_done():
            self.board.say(doing="done", part=1.0, **self._reached())
        else:
            self.board.say(doing="rendering")

    def _compare(self, subject: Subject, compared: bool) -> None:
        self._begun = time.perf_counter()
        self._shown = replace(self._shown, compared=compared)
        self._takes = {"own": self._takes["own"]}
        if compared and takes.alone(self._takes["own"].integrator) is None:
            self._takes["path"] = takes.rival(subject, self._takes["own"].integrator, self._spp, self._seed)
        pictures = {name: picture for name, picture in self.board.pictures.items() if name in self._takes}
        self.board.say(pictures, compared="path" in self._takes)

    def _why_black(self, picture: Picture) -> str | None:
        assert self._subject is not None
        return black.why(self._subject.scene, self._subject.sensor, picture.layers["final"], ON_THE_PAGE)

    def _reached(self) -> dict[str, Any]:
        samples, noise = self._takes["own"].reached()
        return {"samples": samples, "noise": noise}

    def _between(self, part: float) -> None:
        """Between two portions of a wave: errands, a stop, or something else to be seen."""
        self._run_errands()
        if self._halted():
            self.board.say(doing="stopped")
            while self._halted():
                with self._changed:
                    self._changed.wait_for(lambda: not self._halted() or bool(self._errands))
                self._run_errands()
            self.board.say(doing="rendering")
        if self._superseded():
            raise SupersededError
        now = time.perf_counter()
        if now - self._reported > REPORT:
            self._reported = now
            self.board.say(part=part, seconds=now - self._begun)

    def _close(self) -> None:
        self._takes = {}

    def _fail(self, error: BaseException) -> None:
        self._close()
        missing, words = not self._path.exists(), session.message(error)
        if self._subject is None:
            self.files.failed(words)
        self.board.say(doing="missing" if missing else "failed", error=None if missing else pointed(words, self._path))

    def _next_number(self) -> int:
        self._number += 1
        return self._number
