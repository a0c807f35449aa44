"""What is rendered, how, and where it goes: all that the options say, in one value."""

from __future__ import annotations

import functools
import os
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import click
import prosim_scene

from ..engine.checkpoint import Checkpoint
from ..engine.tiles import Part
from ..scene import scene_file
from .options import OPTIONS, choose_variant, refuse_waves

#: Options that become parameters of the integrator, and of the translator.
INTEGRATOR = ("caustics", "max_level", "threshold", "noise", "noise_99", "noise_999", "time", "max_samples", "adaptive")
LANGUAGE = ("light_units", "tolerance", "allow_outside")

#: Options that say when an image is good enough.
ENDS = ("noise", "noise_99", "noise_999", "time")

#: Options that exclude each other: some, others, and what to do.
CONFLICTS = (
    ("spp", "samples", "--spp and --samples both say how many samples a pixel gets; give one of them."),
    ("workers", "cluster", "--workers starts a cluster here, and --cluster names one that runs; give one of them."),
    ("part", "workers cluster", "--part is for processes that know nothing of each other; leave it to the cluster."),
    (
        "part",
        "noise noise_99 noise_999 time",
        "--noise and --time go by the whole image, of which a part knows nothing. Render the parts without them, "
        "with --adaptive none, then prosim merge --keep, and continue the image: prosim resume NAME.state.exr "
        "--noise X --adaptive graded. Where machines can talk to each other, --cluster does it in one step.",
    ),
    ("denoise", "keep part", "--denoise renders two images, and --keep and --part keep the state of one; give either."),
    (
        "frames",
        "part",
        "--part is for single images. To share a film, give each machine some of its --frames: 0:24 here, 24:48 there.",
    ),
    ("frames", "view", "--view is for single images. To see one frame: --frames 7 without it, or -D frame=7 with it."),
)


@dataclass(frozen=True)
class Job:
    """A scene file, what is changed in it, which image of it is rendered, how, and where it goes."""

    scene: str = ""
    variant: str = ""
    definitions: Mapping[str, str] = field(default_factory=dict)
    sensor: int = 0
    seed: int = 0
    #: Samples per pixel, 0 for what the scene says.
    spp: int = 0
    resolution: tuple[int, int] | None = None
    crop: tuple[int, int, int, int] | None = None
    samples: int | None = None
    #: Parameters of the integrator; None takes one away.
    integrator: Mapping[str, Any] = field(default_factory=dict)
    #: Options of the translator.
    language: Mapping[str, Any] = field(default_factory=dict)
    exposure: float | None = None

    # What follows does not change the image.
    output: str | None = None
    denoise: bool = False
    keep: bool = False
    part: Part | None = None
    view: tuple[str, int] | None = None
    frames: range | None = None
    fps: float | None = None
    overwrite: bool = False
    threads: int | None = None
    verbose: int = 0
    workers: int | None = None
    cluster: str | None = None

    @property
    def helpers(self) -> str | None:
        """The option that asks other processes to take the samples."""
        return "--workers" if self.workers else "--cluster" if self.cluster else None

    def image(self) -> dict[str, Any]:
        """What says which image it is, by name."""
        return {name: getattr(self, name) for name in IMAGE}

    @classmethod
    def of(cls, record: Checkpoint) -> Job:
        """The job that a record is of. Raises ValueError where it is of none."""
        try:
            said = dict(record.about["job"])
            tuples = {name: said[name] and tuple(said[name]) for name in ("resolution", "crop")}
            return cls(**(said | tuples))
        except (KeyError, TypeError):
            raise ValueError(
                "this state was not kept by prosim render, so the command can't know what it is of; continue it where "
                "it comes from, by integrator.progressive(begin=...)"
            ) from None

    def about(self, file: scene_file.SceneFile) -> dict[str, Any]:
        """What a record of it has to say, so that another process can continue it: ``job`` and ``digest``."""
        return {"job": self.image() | {"scene": os.path.abspath(self.scene)}, "digest": file.digest()}

    def file(self, folder: Path, **how: Any) -> scene_file.SceneFile:
        """The scene file; ``folder``: for translations; ``how``: see :class:`.scene_file.SceneFile`, which says what is
        raised.
        """
        image = {name: getattr(self, name) for name in ("definitions", "resolution", "crop", "samples", "integrator")}
        return scene_file.SceneFile(self.scene, folder, **image, **how, **self.language)


#: The fields that say which image it is.
IMAGE = tuple(name for name in Job.__dataclass_fields__)[: list(Job.__dataclass_fields__).index("output")]


def takes_job(*names: str) -> Callable[[Callable], Callable]:
    """Decorator: gives a command these options (all: none named), of which it gets a :class:`Job`, its first argument.

    A parameter ``scene`` of the command becomes the job's, unless the job has no option that goes with it.
    """
    chosen = [name for name in OPTIONS if not names or name in names]

    def decorate(command: Callable) -> Callable:
        @functools.wraps(command)
        def build(**given: Any) -> Any:
            options = {name: given.pop(name) for name in chosen}
            if "definitions" in options:
                options["scene"] = given.pop("scene")
            return command(job_of(options), **given)

        built: Callable = build
        for name in reversed(chosen):
            built = OPTIONS[name](built)
        return built

    return decorate


def job_of(options: dict[str, Any]) -> Job:
    """The job that options ask for. Raises UsageError where they contradict each other."""
    given = {name for name, value in options.items() if value is not None and value is not False}
    for one, others, message in CONFLICTS:
        if one in given and given & set(others.split()):
            raise click.UsageError(message)
    if "frames" not in given and (film := given & {"fps", "overwrite"}):
        raise click.UsageError(f"--{min(film)} is for films; say which --frames.")
    scene = options.pop("scene", None)
    begins = scene is not None
    language = {name: value for name in LANGUAGE if (value := options.pop(name, None))}
    warnings.simplefilter("always", prosim_scene.SceneWarning)
    integrator = {name: value for name in INTEGRATOR if (value := options.pop(name, None)) is not None}
    if given & set(ENDS) and begins and integrator.setdefault("adaptive", "graded") == "thesis":
        raise click.UsageError(
            "--adaptive thesis ends each pixel by its own samples, N to N*N, and knows neither --noise nor --time; "
            "leave them out, or take another policy."
        )
    if options.pop("paths", False):
        integrator = {"diffuse_bounces": -1, "max_level": -1, "ambient": None} | integrator
    options["definitions"] = dict(options.get("definitions", ()))
    options["spp"] = options.get("spp") or 0
    if "mode" in options:
        options["variant"] = variant = choose_variant(options.pop("mode"))
        waves = (*ENDS, "max_samples", "adaptive", "keep", "part", "workers", "cluster")
        refuse_waves([f"--{name.replace('_', '-')}" for name in waves if name in given], variant)
    return Job(scene="" if scene is None else str(scene), integrator=integrator, language=language, **options)


def refuse_for_xml(job: Job, *names: str) -> None:
    """Raises UsageError where a scene in XML gets one of these options for scenes in the thesis's language."""
    for name in names:
        if name in job.language and job.scene.lower().endswith(".xml"):
            free = " It may name any file without that option." if name == "allow_outside" else ""
            raise click.UsageError(
                f"--{name.replace('_', '-')} is for scenes in the thesis's language, and {job.scene} is XML.{free}"
            )


def continued(job: Job, asked: Job, **changes: Any) -> Job:
    """``job``, of a record, running as ``asked`` on the command line."""
    running = {name: getattr(asked, name) for name in Job.__dataclass_fields__ if name not in IMAGE}
    return replace(job, **running | changes)
