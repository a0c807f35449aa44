"""The class :class:`Job`, whose fields hold all options of a render, and define the command-line options."""

from __future__ import annotations

import gc
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import Any

import click
import mitsuba as mi

from ..engine.checkpoint import Checkpoint
from ..engine.plan import TARGETS
from ..engine.policies import POLICIES
from ..engine.tiles import Part
from ..scene import scene_file, session
from ..scene.overrides import UNLESS_LIMITED, option_names
from ..transport.radiance import KINDS
from . import option_types as types
from .option_types import InputError, Integer, Number

#: Fields of a Job that become parameters of the integrator.
INTEGRATOR = ("samples", "caustics", "max_level", "layers", "max_samples", "adaptive", *TARGETS)

#: Fields of a Job that do not change the image.
RUNNING = ("output", "checkpoint", "verbose", "frames", "threads", "workers", "cluster", "part")

POSITIVE = Number(0, min_open=True)
UNITS = click.Choice(["calibrated", "radiance", "unattenuated"])
BY_SCENE, WITH_TARGET = "set by the scene", "with --noise, --time: "


def _option(group: str, type_: Any, text: str, *flags: str, **settings: Any) -> Any:
    """Defines a field of a :class:`Job` and its command-line option, with the help ``text``, in a ``group`` of the
    help.

    ``type_`` is the type of the value; None for an option without a value. ``flags`` are further names; a long one
    replaces the name that is made from the name of the field. ``settings`` are further arguments of click's option.
    """
    settings = ({"is_flag": True, "default": False} if type_ is None else {"type": type_, "default": None}) | settings
    return field(default=settings["default"], metadata={"group": group, "flags": flags, "help": text} | settings)


_quality, _output, _scene = (partial(_option, group) for group in ("Quality", "Output", "Scene"))
_film, _distribution, _advanced = (partial(_option, group) for group in ("Film", "Distribution", "Advanced"))


@dataclass(frozen=True)
class Job:
    """All options of a render: the scene file and its changes, the image, the sampling, and the output."""

    scene: str = ""

    noise: float | None = _quality(
        POSITIVE, "Stop when the RMS error of the displayed image is below this (white = 1); 0.01 is usual."
    )
    time: float | None = _quality(POSITIVE, "Stop after this many seconds, at the latest.")
    spp: int | None = _quality(
        Integer(1, 2**24), "Samples of each pixel, whatever target the scene has.", show_default=BY_SCENE
    )
    denoise: bool = _quality(None, "Denoise the image; --noise then limits the error of the denoised image.")

    output: str | None = _output(
        click.Path(), "Name or folder of the output files.", "-o", show_default="the input's folder"
    )
    layers: str | None = _output(
        click.Choice(KINDS[1:]), "Also write layers to the EXR; their sum is the image. See prosim mix."
    )
    exposure: float | None = _output(Number(-64, 64), "Exposure of the PNG in stops.")
    checkpoint: bool = _output(None, "Write checkpoints, NAME.state.npz, from which prosim resume continues.")
    snapshots: tuple[str, ...] | None = _output(
        types.SNAPSHOTS, "Also write NAME.0.04.exr when the RMS error is 0.04, or NAME.4s.exr after 4 s."
    )
    verbose: int = _output(int, "Verbose output; repeat for more.", "-v", count=True, default=0, show_default=False)

    definitions: Mapping[str, str] = _scene(
        types.DEFINITION, "Replace $key in the scene; may be repeated.", "-D", "--define", multiple=True
    )
    sensor: int = _scene(Integer(min=0), "Number of the sensor in the scene, from 0.", "-s", default=0)
    resolution: tuple[int, int] | None = _scene(types.RESOLUTION, "Size of the image in pixels, such as 640x480.")
    crop: tuple[int, int, int, int] | None = _scene(types.CROP, "Render only this window of the image, in pixels.")
    paths: bool = _scene(None, "Path tracing: follow diffuse reflections; omit the ambient term.")
    caustics: bool | None = _scene(
        None, "Light that glass and mirrors focus.", "--caustics/--no-caustics", default=None, show_default=BY_SCENE
    )
    max_level: int | None = _scene(
        Integer(-1, 2**16), "Maximum depth of rays; -1 with --paths: unlimited.", show_default=BY_SCENE
    )
    allow_outside: bool = _scene(None, "Let the scene use files from outside its folder.")

    frames: range | None = _film(types.FRAMES, "Render an animation: frames A, A+STEP, ... below B, or only A.")

    threads: int | None = _distribution(Integer(1, 1024), "Number of threads.", "-t", show_default="all")
    workers: int | None = _distribution(Integer(1, 256), "Use this many local processes.")
    cluster: str | None = _distribution(types.ADDRESS, "Use the workers of the Dask cluster with this scheduler.")
    part: Part | None = _distribution(types.PART, "Render only part K of M, to NAME.K-of-M.npz; see prosim merge.")  # noqa: RUF009

    variant: str = _advanced(
        click.Choice(mi.variants()),
        "Mitsuba variant.",
        "-m",
        "--mode",
        metavar="VARIANT",
        show_default="the first of cuda, metal, llvm and scalar that works here",
    )
    seed: int = _advanced(Integer(0, 2**32 - 1), "Seed of the samples.", default=0)
    samples: int | None = _advanced(
        Integer(1, 2**12), "N of the thesis's N-rook sampling: N samples a pass, at most N*N per pixel."
    )
    noise_99: float | None = _advanced(POSITIVE, "Also require 99 % of the pixels to be within this error.")
    max_samples: int | None = _advanced(
        Integer(1, 2**20), "Maximum number of samples per pixel.", show_default=WITH_TARGET + "unlimited"
    )
    adaptive: str | None = _advanced(
        click.Choice(tuple(POLICIES)),
        "Policy for the number of samples of each pixel.",
        show_default=WITH_TARGET + "graded",
    )
    light_units: str | None = _advanced(
        UNITS, "Meaning of a light's Intensity in the thesis's language.", show_default="calibrated"
    )
    tolerance: float | None = _advanced(
        POSITIVE, "Maximum tessellation error in pixels, in the thesis's language.", show_default="0.1"
    )

    @property
    def integrator(self) -> dict[str, Any]:
        """Parameters for the scene's integrator: name -> new value; the value None removes a parameter.

        With a limit of noise or time, the policy ``adaptive`` is "graded" unless the job sets it. Without one, the last
        of the ``snapshots`` is the limit, unless the scene has one. The field ``paths`` sets the parameters of path
        tracing.
        """
        parameters = {name: value for name in INTEGRATOR if (value := getattr(self, name)) is not None}
        if any(name in parameters for name in TARGETS):
            parameters.setdefault("adaptive", "graded")
        elif self.snapshots:
            amounts = [float(text.removesuffix("s")) for text in self.snapshots]
            last = {"time": max(amounts)} if self.snapshots[0].endswith("s") else {"noise": min(amounts)}
            parameters[UNLESS_LIMITED] = {"adaptive": "graded"} | last
        return ({"diffuse_bounces": -1, "ambient": None} if self.paths else {}) | parameters

    @property
    def language(self) -> dict[str, Any]:
        """The options of the scene translator that this job sets; see :data:`.scene_file.TRANSLATION`."""
        return {name: value for name in scene_file.TRANSLATION if (value := getattr(self, name, None))}

    @property
    def distributed(self) -> str | None:
        """The option that distributes the render to other processes: "--workers", "--cluster" or None."""
        return "--workers" if self.workers else "--cluster" if self.cluster else None

    def image_fields(self) -> dict[str, Any]:
        """Returns name -> value of the fields of this job that determine the image."""
        return {name: getattr(self, name) for name in FIELDS if name not in RUNNING}

    @classmethod
    def of(cls, checkpoint: Checkpoint) -> Job:
        """Returns the job that a checkpoint stores; raises ValueError if prosim render did not write the checkpoint."""
        try:
            saved = {name: from_json(name, value) for name, value in checkpoint.about["job"].items()}
            return cls(**saved | {"variant": checkpoint.environment["variant"]})
        except (ArithmeticError, AttributeError, KeyError, TypeError, ValueError, click.BadParameter):
            raise ValueError(
                "prosim render did not write this state; continue it in the Python program that wrote it, by "
                "integrator.progressive(begin=...)"
            ) from None

    def read_scene(self, folder: Path, **how: Any) -> scene_file.SceneFile:
        """Reads the scene file of this job, as :class:`.scene_file.SceneFile` with the further arguments ``how``; the
        translator writes to ``folder``.
        """
        names = "definitions", "resolution", "crop", "integrator", "sensor"
        changes = {name: getattr(self, name) for name in names}
        return scene_file.SceneFile(self.scene, folder, **changes, **how, **self.language)


def from_json(name: str, value: Any) -> Any:
    """Returns the ``value``, from JSON, of the field ``name`` of a :class:`Job`, after a check by the type of its
    option. Raises exceptions of many kinds, such as BadParameter and TypeError, if the value is not allowed.
    """
    field_, settings = Job.__dataclass_fields__[name], Job.__dataclass_fields__[name].metadata
    if value in (None, 0.0) and field_.default is None:  # 0: no limit, where the scene has one
        return value
    if (type_ := settings.get("type")) is None:
        if type(value) is not (bool if settings else str):
            raise TypeError(f"{name}: {value}")
        return value
    if name == "definitions":
        return dict(type_.convert(f"{key}={text}", None, None) for key, text in value.items())
    text = ("x" if name == "resolution" else ",").join(map(str, value)) if type(value) is list else value
    return type_.convert(text, None, None)


FIELDS = tuple(one.name for one in fields(Job))

#: The fields of a Job that have a command-line option.
OPTIONS = tuple(one.name for one in fields(Job) if one.metadata)


def job_options(*names: str) -> Callable[[Callable], Callable]:
    """Returns a decorator that adds to a command the command-line options of the :class:`Job` fields ``names``."""

    def decorate(command: Callable) -> Callable:
        for name in reversed(names):
            settings = dict(Job.__dataclass_fields__[name].metadata)
            flags = settings.pop("flags")
            if not any(flag.startswith("--") for flag in flags):
                flags = *flags, f"--{name.replace('_', '-')}"
            command = types.option(settings.pop("group"), *flags, name, **settings)(command)
        return command

    return decorate


#: The groups of options, in the order of the help. The last group has the options that belong to no other group.
GROUPS = ("Quality", "Output", "Scene", "Film", "Comparison", "Page", "Distribution", "Advanced", "Others")


class Command(click.Command):
    """A click command whose function gets the scene and the options of :func:`job_options` as the :class:`Job` ``job``,
    and whose help shows the options in groups.
    """

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parses the arguments, and makes the :class:`Job`, unless a shell completes the command. Raises the errors of
        :func:`make_job`.
        """
        rest = super().parse_args(ctx, args)
        if not ctx.resilient_parsing:
            ctx.params["job"] = make_job({name: ctx.params.pop(name) for name in FIELDS if name in ctx.params})
        return rest

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Writes the options of the command to the help text, in groups."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for param in self.get_params(ctx):
            if isinstance(param, click.Option) and (record := param.get_help_record(ctx)) is not None:
                groups.setdefault(getattr(param, "group", GROUPS[-1]), []).append(record)
        for group, records in sorted(groups.items(), key=lambda item: GROUPS.index(item[0])):
            with formatter.section(group):
                formatter.write_dl(records)


#: Options that exclude each other: an option, the options that cannot be combined with it, and the error message.
CONFLICTS = (
    ("spp", "samples", "--spp and --samples both set the number of samples; give one of them."),
    (
        "spp",
        " ".join((*TARGETS, "snapshots", "max_samples", "adaptive")),
        "--spp gives each pixel exactly so many samples; leave it out with --noise, --time, --snapshots, --adaptive "
        "(unless none) and --max-samples, which sets a maximum.",
    ),
    ("workers", "cluster", "--workers starts local workers, and --cluster names a running cluster; give one of them."),
    ("part", "workers cluster", "--part is for machines without a connection; leave out --part with a cluster."),
    (
        "part",
        " ".join(TARGETS),
        "--noise and --time need the whole image, and a part knows only its own pixels. Render the parts without them, "
        "with --adaptive none; then prosim merge --checkpoint, and prosim resume NAME.state.npz --noise X --adaptive "
        "graded. Where the machines are connected, --cluster does all that.",
    ),
    ("denoise", "part", "--denoise needs the whole image, and --part renders a part of it; give one of them."),
    ("snapshots", "denoise part frames", "--snapshots writes raw single images; leave out the other option."),
    ("layers", "denoise", "--denoise changes the image, and --layers are parts of the raw image; give one of them."),
    ("layers", "caustics", "--layers lights: the photons of --caustics do not know their light; omit one of them."),
    ("frames", "part", "--part is for single images. Let each machine render some of the --frames: 0:24, 24:48."),
)


def make_job(options: dict[str, Any]) -> Job:
    """Returns the job for ``options``, field of a :class:`Job` -> value; if there is a variant, sets it and loads the
    plugins.

    Raises UsageError if options contradict each other, InputError if the variant cannot do them, and the errors of
    :func:`choose_variant`.
    """
    given = {name for name, value in options.items() if value}
    uniform = {"adaptive"} if options.get("adaptive") == "none" else set()
    for option, others, message in CONFLICTS:
        if option in given and (given - uniform) & set(others.split()):
            raise click.UsageError(message)
    if given & {*TARGETS, "snapshots"} and not POLICIES[options.get("adaptive") or "graded"].unbounded:
        raise click.UsageError(
            f"--adaptive {options['adaptive']} does not measure the noise; leave it out with --noise, --time and "
            "--snapshots."
        )
    options["scene"] = str(options.get("scene") or "")
    if "snapshots" in given and given & {*TARGETS} == {"time"} and not options["snapshots"][0].endswith("s"):
        raise click.UsageError("--snapshots of errors: --time alone does not measure the error; add --noise.")
    options["definitions"] = dict(options.get("definitions", ()))
    if "variant" in options:
        options["variant"] = choose_variant(options["variant"])
        progressive = [*TARGETS, "snapshots", "max_samples", "adaptive", "checkpoint", "part", "workers", "cluster"]
        progressive += ["samples"] if options["scene"].lower().endswith(".xml") else []
        refuse_scalar(option_names(name for name in progressive if name in given), options["variant"])
    return Job(**options)


def choose_variant(name: str | None) -> str:
    """Sets the Mitsuba variant ``name``, or the default if it is None, loads all plugins, and returns the variant's
    name.

    Warns if the variant is scalar. Raises ImportError if Mitsuba lacks the variant, and ClickException if this machine
    cannot use it.
    """
    gc.disable()  # modules make many objects and no garbage
    try:
        variant = session.set_variant(name)
    except RuntimeError as error:
        raise click.ClickException(session.message(error)) from None
    finally:
        gc.enable()
    if variant.startswith("scalar_"):
        click.echo(f"{variant}: plugins in Python are hundreds of times slower than in an llvm variant", err=True)
    return variant


def refuse_scalar(names: str, variant: str) -> None:
    """Raises InputError if ``variant`` is scalar and ``names`` is not empty: the options, parameters or commands in use
    that need progressive rendering.
    """
    if variant.startswith("scalar_") and names:
        raise InputError(
            f"{names}: {variant} renders pixel by pixel, not progressively. Give another variant, "
            "such as -m llvm_ad_rgb (prosim doctor lists those of this machine), or --spp."
        )
