"""What a worker is asked to do: a portion of an image's samples, or a whole image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from ..engine.work import WorkItem
from ..photons.caustics import Which
from . import message, worker
from .parcel import Parcel


@dataclass(frozen=True)
class Errand:
    """``function(variant, *arguments, *files)``, of :mod:`.worker`, and what becomes of its answer. ``work``: samples
    that it takes, about; ``wrong``: what is said where it goes wrong; ``files``: contents that workers have already, or
    pass on to each other; ``sets``: of photons that it needs, and that these draw for each other; ``plan``: by which.
    """

    function: Callable[..., worker.Done | None]
    arguments: tuple[Any, ...]
    work: int
    read: Callable[[Any], Any]
    wrong: str = "samples could not be taken"
    files: list[bytes] = field(default_factory=list)
    sets: list[Which] = field(default_factory=list)
    plan: tuple[Any, ...] = ()

    @classmethod
    def portion(cls, portion: WorkItem, key: str) -> Errand:
        """Takes the samples of ``portion``, of the scene with this key; reads ``(portion, samples)``."""
        asked = message.request(portion)
        sets, plan = portion.sets(), asked["plan"]
        arguments = key, asked, sets
        return cls(
            worker.take, arguments, portion.work, lambda what: (portion, message.answered(*what)), sets=sets, plan=plan
        )

    @classmethod
    def whole(cls, image: Whole, before: str, there: Callable[[bytes], bool]) -> Errand:
        """Makes an image; reads ``(image, what it came to)``. ``before``: see :func:`.worker.make`; ``there``: whether
        workers have this file's content already.
        """
        files = {name: content for name, content in image.parcel.contents.items() if there(content)}
        new = {name: content for name, content in image.parcel.contents.items() if name not in files}
        arguments = (replace(image.parcel, contents=new), before, list(files), image.make, image.arguments)
        return cls(
            worker.make,
            arguments,
            image.work,
            lambda what: (image, what),
            f"{image.name} could not be rendered",
            list(files.values()),
        )


@dataclass(frozen=True, eq=False)
class Whole:
    """An image that one worker makes: ``make(scene, sensor, wanted, *arguments)`` there, of the scene in ``parcel``;
    ``wanted`` says whether it still is. ``name``: in words; ``work``: samples that it takes, about.
    """

    name: str
    parcel: Parcel
    make: Callable[..., Any]
    arguments: tuple[Any, ...]
    work: int
