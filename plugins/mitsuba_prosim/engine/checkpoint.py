"""Checkpoints of progressive renders as files: another process continues them, or puts the parts of an image together.

A checkpoint is a ZIP archive of NumPy arrays (``.npz``), not compressed: ``facts``, which is JSON, and the arrays of
the pixels and of the second image. Its checksums are those of ZIP.
"""

from __future__ import annotations

import json
import time
import warnings
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import atomic
from ..compat import dr_array
from . import origin
from .accumulators import Accumulators, FilmState
from .tiles import Part, Tiles

#: The version of the format; and how files of older ones began, which were OpenEXR images with such an attribute.
FORMAT, OLDER, ATTRIBUTE = 7, b"\x76\x2f\x31\x01", b"prosim.state"

#: Parameters of sampling that do not change the samples; those that end a render; and those that decide who gets
#: samples. A checkpoint may continue with others than its own of the last two.
FREE, ENDS, DECIDING = ("band",), ("noise", "noise_99", "noise_999", "time"), ("adaptive", "threshold", "max_samples")

#: Facts that parts of one image may differ in.
ANY = ("scene", "exposure", *origin.CLOSE)

#: The adaptive state of each pixel.
ADAPTIVE = ("requested", "wanted")


class CheckpointError(ValueError):
    """A file from which no render can be continued."""


class NotACheckpointError(CheckpointError):
    """A file of another kind."""


@dataclass(frozen=True)
class Checkpoint:
    """A :class:`.FilmState` between two steps, as NumPy arrays, to the bit.

    ``facts``: names and numbers, as JSON; ``pixels``: name -> values of all pixels of the state, shape (pixels,);
    ``second``: the same of the second image. ``about``: further facts of the caller, as JSON.
    """

    facts: Mapping[str, Any]
    pixels: Mapping[str, np.ndarray]
    second: Mapping[str, np.ndarray]
    about: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, state: FilmState, seconds: float, finished: bool) -> Checkpoint:
        """The checkpoint of ``state`` after ``seconds``; ``finished``: the image has all requested samples."""
        facts = {
            "samples": identity(state),
            "sampling": {name: value for name, value in asdict(state.plan.sampling).items() if name not in FREE},
            "part": None if state.part is None else (state.part.number, state.part.of),
            "tiles": None if state.tiles is None else (state.tiles.columns, state.tiles.rows),
            "region": state.plan.region,
            "outer": state.outer,
            "endless": state.plan.endless,
            "noise": state.noise,
            "slope": state.slope,
            "estimates": state.estimates,
            "rounds": state.rounds,
            "effort": state.effort,
            "seconds": seconds,
            "finished": finished,
        }
        adaptive = {name: values for name in ADAPTIVE if (values := getattr(state, name)) is not None}
        second = {} if state.second is None else arrays(state.second)
        return cls(json.loads(json.dumps(facts)), arrays(state.accumulators) | adaptive, second)

    @property
    def finished(self) -> bool:
        """Whether the image has all requested samples."""
        return bool(self.facts["finished"])

    @property
    def part(self) -> Part | None:
        """The part of the image; None for the whole image."""
        return Part(*self.facts["part"]) if self.facts["part"] else None

    def restore(self, state: FilmState) -> bool:
        """Copies this checkpoint into ``state``, which has no samples yet; returns whether the image was finished with
        the same target. Decisions for another target are taken again.

        Raises ValueError if these are the samples of another image.
        """
        mine, theirs = self.facts["samples"], json.loads(json.dumps(identity(state)))
        for name, value in theirs.items():
            if mine.get(name) != value:
                raise ValueError(
                    f"these are the samples of another image ({name}: {mine.get(name)} there, {value} here)"
                )
        decided = self._agrees(state, DECIDING)
        if not decided and state.plan.sampling.adaptive == "neighbours":
            raise ValueError(
                "adaptive = neighbours decides once, by the first samples alone; continue with adaptive = graded if "
                "threshold, max_samples or adaptive differ"
            )
        # Further samples may be of an endless sequence after N-rook patterns, but not the reverse.
        state.plan = replace(state.plan, endless=state.plan.endless or self.facts["endless"])
        rms, most, nearly_all = self.facts["noise"]
        state.noise, state.slope = (rms, most, nearly_all), self.facts["slope"]
        state.estimates = [tuple(estimate) for estimate in self.facts["estimates"]]
        pixels = {name: self._placed(values, state) for name, values in self.pixels.items()}
        state.accumulators = accumulators(pixels)
        state.second = accumulators(self.second) if self.second else None
        if decided:
            state.rounds, state.effort = self.facts["rounds"], self.facts["effort"]
            state.requested, state.wanted = (pixels.get(name) for name in ADAPTIVE)
        return decided and self.finished and self._agrees(state, ENDS)

    def _agrees(self, state: FilmState, parameters: Sequence[str]) -> bool:
        theirs = asdict(state.plan.sampling)
        return all(self.facts["sampling"][name] == theirs[name] for name in parameters)

    def _placed(self, values: np.ndarray, state: FilmState) -> np.ndarray:
        """An array, laid out over the pixels of ``state``: there are more if its policy looks farther."""
        mine, theirs = tuple(self.facts["outer"]), state.outer
        if mine == theirs:
            return values
        plane = values.reshape(mine[3] - mine[1], mine[2] - mine[0])
        both = max(mine[0], theirs[0]), max(mine[1], theirs[1]), min(mine[2], theirs[2]), min(mine[3], theirs[3])
        result = np.zeros((theirs[3] - theirs[1]) * (theirs[2] - theirs[0]), values.dtype)
        part = plane[both[1] - mine[1] : both[3] - mine[1], both[0] - mine[0] : both[2] - mine[0]]
        state.crop(result, both)[:] = part
        return result

    def write(self, path: Path) -> None:
        """Writes the archive over ``path``. Pixels without samples, such as those of other parts, are left out.

        Raises OSError.
        """
        index = np.flatnonzero(self.pixels["count"])
        facts = {"format": FORMAT, "origin": origin.here(), "about": dict(self.about), "facts": dict(self.facts)}
        contents: dict[str, Any] = {"facts": np.array(json.dumps(facts)), "index": index}
        contents |= {f"pixels.{name}": values[index] for name, values in self.pixels.items()}
        contents |= {f"second.{name}": values for name, values in self.second.items()}
        with open(path, "wb") as file:
            np.savez(file, **contents)


def identity(state: FilmState) -> dict[str, Any]:
    """The facts that identify the samples and the sums of an image."""
    plan, caustics = state.plan, state.estimator.transport.caustics
    return {
        "samples of a pass": plan.n,
        "samples that every pixel gets": plan.least,
        "jitter": plan.sampling.jitter,
        "photons of a set": None if caustics is None else caustics.count,
        "seed": int(plan.seed[0]),
        "window": plan.window,
        "pixels that have samples": plan.domain,
        "reach of the filter": plan.reach,
        "channels": state.estimator.channels.names,
    }


def arrays(sums: Accumulators) -> dict[str, np.ndarray]:
    """The arrays of accumulators by name."""
    named = {f.name: getattr(sums, f.name) for f in fields(sums) if f.name != "sums"}
    named |= {f"sum{k}": values for k, values in enumerate(sums.sums)}
    return {name: np.array(values) for name, values in named.items()}


def accumulators(named: Mapping[str, np.ndarray]) -> Accumulators:
    """The accumulators of which these are the :func:`arrays`."""
    values = {name: dr_array(values) for name, values in named.items() if name not in ADAPTIVE}
    sums = [values.pop(f"sum{k}") for k in range(sum(name.startswith("sum") for name in values))]
    return Accumulators(sums, **values)


# ---------------------------------------------------------------- files


def save(checkpoint: Checkpoint, path: str | Path) -> None:
    """Writes ``checkpoint`` to ``path``, over an older file when it is complete. Raises OSError."""
    atomic.write({Path(path): checkpoint.write})


def read(path: str | Path, arrays: bool = True) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The facts of a checkpoint (``about``, ``origin`` and ``facts``), and its arrays, if wanted.

    Raises NotACheckpointError for a file of another kind; CheckpointError for one of another version of this program,
    or a damaged or incomplete one; OSError.
    """
    with open(path, "rb") as file:
        begin = file.read(1 << 16)
        if begin.startswith(OLDER) and ATTRIBUTE in begin:
            raise CheckpointError(
                f"{path} was written by an older version of mitsuba-prosim; finish it with that one, or render again"
            )
        if not begin.startswith(b"PK") or b"facts.npy" not in begin:
            raise NotACheckpointError(f"{path} is no checkpoint; --keep and --part write some")
        try:
            file.seek(0)
            with np.load(file) as archive:
                text: dict[str, Any] = json.loads(str(archive["facts"]))
                contents = {name: archive[name] for name in archive.files if name != "facts"} if arrays else {}
        except (zipfile.BadZipFile, ValueError, KeyError, EOFError, NotImplementedError):
            raise CheckpointError(f"{path} is damaged or not complete; render again") from None
    if text["format"] != FORMAT:
        raise CheckpointError(
            f"{path} has format {text['format']}, and this version reads format {FORMAT}; finish it with the version "
            "that wrote it, or render again"
        )
    return text, contents


def about(path: str | Path) -> dict[str, Any]:
    """The facts of a checkpoint: ``about``, ``origin`` and ``facts``. Raises as :func:`read`."""
    return read(path, arrays=False)[0]


def load(path: str | Path, warn: bool = True) -> Checkpoint:
    """Reads a checkpoint, and warns if it comes from another kind of processor, if ``warn``.

    Raises as :func:`read`, and CheckpointError if it was made by other versions or in another variant.
    """
    text, contents = read(path)
    ours, index = origin.here(), contents.pop("index", None)
    if different := origin.differences(text["origin"], ours, origin.EXACT):
        raise CheckpointError(
            f"{path} was made elsewhere ({different}), where samples differ; continue it there, or render again"
        )
    if warn and (different := origin.differences(text["origin"], ours, origin.CLOSE)):
        warnings.warn(
            f"{path} was made elsewhere ({different}): further samples are as good, but may differ in their last bits "
            "from those that would have been added there",
            stacklevel=2,
        )
    left, top, right, bottom = text["facts"]["outer"]
    groups: dict[str, dict[str, np.ndarray]] = {"pixels": {}, "second": {}}
    for name, values in contents.items():
        group, _, name = name.partition(".")
        if group == "pixels":
            whole = np.zeros((right - left) * (bottom - top), values.dtype)
            whole[index] = values
            values = whole
        groups[group][name] = values
    return Checkpoint(text["facts"], groups["pixels"], groups["second"], text["about"])


class CheckpointWriter:
    """Writes the checkpoint of a render to ``path`` from time to time, and at its end.

    ``about``: that of :class:`Checkpoint`; ``warn``: receives a message the first time that writing fails.
    """

    #: Least seconds between two checkpoints, and the part of the time that writing may take.
    SHORTEST, SHARE = 4.0, 0.02

    def __init__(self, path: Path, about: Mapping[str, Any], warn: Callable[[str], None] = warnings.warn) -> None:
        self.path, self.about, self.warn = path, about, warn
        self.next, self.failed = time.perf_counter() + self.SHORTEST, False
        #: The last checkpoint, if it could not be written.
        self.unwritten: atomic.Content | None = None

    def __call__(self, render: Any, last: bool = False) -> None:
        """Writes the checkpoint of ``render`` if it is time for it, or the ``last`` one."""
        started = time.perf_counter()
        if not last and started < self.next:
            return
        content = replace(render.checkpoint(), about=self.about).write
        try:
            atomic.write({self.path: content})
        except OSError as error:
            if last:
                self.unwritten = content
            elif not self.failed:
                self.warn(
                    f"{self.path}: the checkpoint can't be written: {error.strerror or error}; the render continues"
                )
            self.failed = True
        end = time.perf_counter()
        self.next = end + max(self.SHORTEST, (end - started) / self.SHARE)


# ---------------------------------------------------------------- parts


def merge(paths: Sequence[str | Path]) -> Checkpoint:
    """The checkpoint of the image whose parts are in the files ``paths``, in any order. One part is read at a time.
    Warns, once, if some come from other kinds of processors.

    Raises CheckpointError if a part is missing, there twice, not finished, or of another image; and as :func:`load`.
    """
    check_parts({Path(path): about(path) for path in paths})
    ours = origin.here()
    elsewhere = [where for path in paths if (where := origin.differences(about(path)["origin"], ours, origin.CLOSE))]
    if elsewhere:
        warnings.warn(
            f"{len(elsewhere)} of {len(paths)} parts were made elsewhere ({'; '.join(dict.fromkeys(elsewhere))}): "
            "their samples are as good, but may differ in their last bits from those that are made here",
            stacklevel=2,
        )
    return put_together(load(path, warn=False) for path in paths)


def put_together(parts: Iterable[Checkpoint]) -> Checkpoint:
    """The checkpoint of the image of which these are all parts, in any order; they are looked at one by one."""
    result: Checkpoint | None = None
    for checkpoint in parts:
        facts, part = checkpoint.facts, checkpoint.part
        assert part is not None
        (columns, rows), region = facts["tiles"], facts["region"]
        tiles = Tiles((region[0], region[1], region[2], region[3]), columns, rows, part.of)
        left, top, right, bottom = facts["outer"]
        y, x = np.ogrid[top:bottom, left:right]
        mine = tiles.owned(part, x, y).ravel()
        if result is None:
            empty = {name: np.zeros_like(values) for name, values in checkpoint.pixels.items()}
            result = replace(checkpoint, facts={**facts, "part": None, "tiles": None, "seconds": 0.0}, pixels=empty)
        for name, values in result.pixels.items():
            np.copyto(values, checkpoint.pixels[name], where=mine)
        seconds = result.facts["seconds"] + facts["seconds"]
        result = replace(result, facts={**result.facts, "seconds": seconds})
    assert result is not None
    return result


def check_parts(texts: Mapping[Path, Mapping[str, Any]]) -> None:
    """Raises CheckpointError unless these are the facts of all parts of one image, each once."""
    found: dict[Part, Path] = {}
    for path, text in texts.items():
        facts = text["facts"]
        if not facts["part"]:
            raise CheckpointError(
                f"{path} is the state of a whole image, not a part of one; continue it by prosim resume"
            )
        other, first = next(iter(texts.items()))
        mine, theirs = common_facts(text), common_facts(first)
        if different := ", ".join(
            f"{k}: {v} here, {theirs.get(k)} there" for k, v in mine.items() if v != theirs.get(k)
        ):
            raise CheckpointError(f"{path} is not of the image that {other} is a part of ({different})")
        if (part := Part(*facts["part"])) in found:
            raise CheckpointError(f"{path} is part {part}, as {found[part]} is already; name each part once")
        if not facts["finished"]:
            raise CheckpointError(f"{path} is not finished; continue it first: prosim resume {path}")
        found[part] = path
    if not found:
        raise CheckpointError("no parts are named; name all parts of an image")
    of = part.of
    if missing := [str(number) for number in range(1, of + 1) if Part(number, of) not in found]:
        names = f"part {missing[0]} is" if len(missing) == 1 else f"parts {', '.join(missing)} are"
        raise CheckpointError(f"of {of} parts, {names} missing")


def common_facts(text: Mapping[str, Any]) -> dict[str, Any]:
    """The facts that all parts of one image have in common."""
    facts, of = text["facts"], text["about"]
    everything = facts["samples"] | facts["sampling"] | text["origin"] | of.get("job", {})
    return {
        "number of parts": facts["part"] and facts["part"][1],
        "content of the scene": of.get("digest", "unknown")[:12],
        **{name: value for name, value in everything.items() if name not in ANY},
    }
