"""Small frames of a film, each made by one worker: what goes before its samples, all workers do at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

import click
import mitsuba as mi

from . import output as files
from .developed import Developed, develop, take
from .frames import Frame, naming
from .job import Job
from .making import SUFFIXES
from .options import wrong_input

if TYPE_CHECKING:
    from ..cluster.errand import Whole
    from ..cluster.remote import Remote

#: Seconds that one worker takes for a frame, at most. Where it is more, all workers share each frame: it is sooner
#: there, and less is lost with it.
SMALL = 30.0


def render(
    scene: mi.Scene, sensor: mi.Sensor, wanted: Callable[[], bool], job: Job, facts: dict[str, str]
) -> Developed:
    """What a worker does for a frame."""
    start = perf_counter()
    picture = take(scene, sensor, job, job.denoise, None, lambda: not wanted())
    return develop(job, scene, sensor, picture, perf_counter() - start, further=facts)


@dataclass
class Apart:
    """Frames, each made by one of the workers of ``taker``. ``size``: bytes of one at most; ``seconds``, ``work``: that
    one worker takes for one, and its samples, about.
    """

    taker: Remote
    size: int
    seconds: float
    work: int

    def write(self, frames: Iterator[Frame], stopped: Callable[[], bool]) -> Iterator[tuple[Frame, Developed, str]]:
        """Makes and writes frames in the order in which they are done, as long as they are small; yields each, what was
        made of it, and what is said of that. It ends as well where it is ``stopped``, or the cluster is gone.

        What is wrong with a frame is raised when those before it are there. Raises ClickException.
        """
        from ..cluster.faults import ClusterError

        asked: dict[Whole, Frame] = {}
        wrong: list[click.ClickException] = []

        def images() -> Iterator[Whole]:
            while self.seconds <= SMALL:
                try:
                    if (frame := next(frames, None)) is None:
                        return
                    image = self._image(frame)
                except click.ClickException as error:
                    wrong.append(error)
                    return
                asked[image] = frame
                yield image

        try:
            for answer in self.taker.make(images()):
                if stopped():
                    break
                if answer is None:
                    continue
                image, made = answer
                frame = asked.pop(image)
                self.seconds = made.seconds
                with naming(frame.number):
                    paths = files.save(frame.stem, made.contents)
                said = made.line(frame.job, frame.file, paths), *made.said
                yield frame, made, "\n".join(filter(None, said))
        except ClusterError as error:
            raise click.ClickException(str(error)) from None
        if wrong and not stopped() and not self.taker.gone:
            raise wrong[0]

    def _image(self, frame: Frame) -> Whole:
        from ..cluster.errand import Whole
        from ..cluster.parcel import Parcel

        with naming(frame.number):
            files.check(Path(frame.job.scene), frame.stem, SUFFIXES, self.size)
            files.spare(frame.sources(), files.SOURCES, frame.stem, SUFFIXES)
            with wrong_input():
                parcel = Parcel.of(frame.file, frame.job.sensor)
        return Whole(f"frame {frame.number}", parcel, render, (frame.job, frame.facts), self.work)
