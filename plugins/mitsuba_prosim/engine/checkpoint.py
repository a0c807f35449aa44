"""Checkpoints: progressive renders stored as files.

Another process can continue the render of a checkpoint, or merge the checkpoints of the parts of one image
(:class:`.tiles.Part`, a set of tiles). A checkpoint is a ZIP archive of NumPy arrays (``.npz``) without compression.
The archive of a checkpoint contains ``facts`` (a JSON text), the arrays of the pixels, and the arrays of the second
image. The checksums of the ZIP archive reveal damaged data when a checkpoint is read. The comment of the archive is a
digest of these checksums; it reveals that another program has changed the archive.
"""

from __future__ import annotations

import io
import json
import time
import warnings
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np

from .. import atomic
from .accumulators import Accumulators
from .environment import MAY_DIFFER, MUST_AGREE, differences, this_environment
from .image import Image
from .plan import SAMPLING, SHARED, TARGETS, Sampling
from .policies import POLICIES
from .tiles import Part

#: Version of the format.
FORMAT = 16

#: Parameters of sampling that decide how many samples a pixel gets. A render may continue from a checkpoint with other
#: values of these parameters, and with other :data:`.TARGETS`.
DECIDING = ("adaptive", "threshold", "max_samples")

#: Name of each attribute -> whether a value in a file is allowed. An exception, too, means that it is not allowed.
ALLOWED: Mapping[str, Callable[[Any], bool]] = {
    "samples": lambda value: type(value) is dict,  # restore() compares the items
    "sampling": lambda value: (
        value.keys() == set(SAMPLING)
        and value["adaptive"] in POLICIES
        and all(is_number(value[f.name], 0, np.inf) for f in fields(Sampling) if f.type == "float")
        and all(is_integer(value[f.name], 0, 2**32) for f in fields(Sampling) if f.type == "int")
    ),
    "part": lambda value: value is None or (all(is_integer(n, 1, 9999) for n in value) and Part(*value) is not None),
    "uses_sobol": lambda value: type(value) is bool,
    "shared": lambda value: is_integer(value, 0, max(SHARED)),
    "noise": lambda value: len(value) == 3 and all(error != error or is_number(error, 0, np.inf) for error in value),
    "estimates": lambda value: all(
        is_number(samples, 0.5, 1e9) and is_number(ratio, 0, np.inf) for samples, ratio in value
    ),
    "rounds": lambda value: is_integer(value, 0, 2**32),
    "seconds": lambda value: is_number(value, 0, 1e12),
    "finished": lambda value: type(value) is bool,
}


def is_number(value: Any, low: float, high: float) -> bool:
    """Tells whether ``value`` is an integer or a float in the range from ``low`` to ``high``, which include it."""
    return type(value) in (int, float) and low <= value <= high


def is_integer(value: Any, low: int, high: int) -> bool:
    """Tells whether ``value`` is an integer, but no bool, in the range from ``low`` to ``high``."""
    return type(value) is int and low <= value <= high


#: Attributes in which the parts of one image may differ.
PARTS_MAY_DIFFER = ("scene", "exposure", "band", *MAY_DIFFER)

#: The prefixes of the names of arrays in a file: arrays of the pixels, and of the second image.
PIXELS, SECOND = "pixels.", "second."

#: The suffix of the names of members, and the member with the JSON text.
NPY, FACTS = ".npy", "facts.npy"


class CheckpointError(ValueError):
    """Raised for a checkpoint file from which no render can continue."""


class NotACheckpointError(CheckpointError):
    """Raised for a file that is no checkpoint."""


@dataclass(frozen=True)
class Checkpoint:
    """A bit-identical copy, as NumPy arrays, of the :class:`.Image` between two steps of a render.

    ``attributes`` describe the image and the progress of the render, as values for JSON. ``pixels`` maps names of
    arrays to arrays with one value for each pixel that has samples, shape (number of pixels,). The array
    ``pixels["index"]`` has the index of each stored pixel in the rectangle ``plan.domain``, row by row. ``second`` maps
    names of arrays to the accumulators of the second image; empty without a second image. ``about`` are attributes that
    the caller adds, as values for JSON. ``environment`` describes the process that took the samples, see
    :func:`.this_environment`.
    """

    attributes: Mapping[str, Any]
    pixels: Mapping[str, np.ndarray]
    second: Mapping[str, np.ndarray]
    about: Mapping[str, Any] = field(default_factory=dict)
    environment: Mapping[str, str] = field(default_factory=this_environment)

    @classmethod
    def of(cls, state: Image, seconds: float, finished: bool) -> Checkpoint:
        """Returns the checkpoint of ``state`` after ``seconds`` of rendering.

        ``finished`` tells whether the image has all requested samples. A checkpoint does not have the pixels without
        samples. The checkpoint of a finished part of an image does not have the pixels around the part either, because
        only the decisions of adaptive sampling needed these pixels.
        """
        attributes = {
            "samples": identity(state),
            "sampling": asdict(state.plan.sampling),
            "part": None if state.part is None else (state.part.number, state.part.of),
            "uses_sobol": state.plan.uses_sobol,
            "shared": state.plan.shared,
            "noise": state.noise,
            "estimates": state.estimates,
            "rounds": state.rounds,
            "seconds": seconds,
            "finished": finished,
        }
        sums = state.accumulators
        pixels = sums.arrays(state.own) | {"index": index(state)}
        if state.wanted is not None:
            pixels["wanted"] = state.wanted
        needed = state.counts_of_part(pixels["count"], 0) if finished else pixels["count"]
        if not needed.all():
            pixels = {name: values[needed > 0] for name, values in pixels.items()}
        # The attributes are those that a file would give back: lists in place of tuples.
        second = sums.arrays(state.second.own) if state.second else state.second_sums
        return cls(json.loads(json.dumps(attributes)), pixels, second)

    @property
    def finished(self) -> bool:
        """Whether the image has all requested samples."""
        return bool(self.attributes["finished"])

    @property
    def part(self) -> Part | None:
        """The part of the image whose samples the checkpoint has; None for the whole image."""
        return Part(*self.attributes["part"]) if self.attributes["part"] else None

    def n(self, sampling: Sampling) -> int:
        """The N of all passes of an image that continues from this checkpoint with the parameters ``sampling``: that of
        its first passes, which a maximum of samples may have lowered. If N cannot continue, :meth:`restore` refuses it.
        """
        n, same = self.attributes["samples"].get("samples of a pass"), self.attributes["sampling"]["samples"]
        return n if same == sampling.samples and is_integer(n, 1, sampling.samples) else sampling.n

    def restore(self, state: Image) -> bool:
        """Copies this checkpoint into ``state``, which has no samples yet.

        If one of the sampling parameters :data:`DECIDING` differs between the checkpoint and ``state``, the policy of
        adaptive sampling decides again. Returns whether the image needs no more samples: the checkpoint is finished,
        and ``state`` has the same parameters :data:`DECIDING` and :data:`.TARGETS`. Raises ValueError if the checkpoint
        has the samples of another image, or if a parameter of :data:`DECIDING` differs and the policy of ``state``
        cannot decide again.
        """
        mine, theirs = self.attributes["samples"], json.loads(json.dumps(identity(state)))
        if name := next((name for name, value in theirs.items() if mine.get(name) != value), None):
            here = f"{name}: {mine.get(name)} there, {theirs[name]} here"
            raise ValueError(f"these are the samples of another image ({here}); use its scene and options")
        sampling = asdict(state.plan.sampling)
        changed = {name for name, value in sampling.items() if self.attributes["sampling"][name] != value}
        decided = changed.isdisjoint(DECIDING)
        if not decided and not state.policy.decides_again:
            raise ValueError(
                f"adaptive = {sampling['adaptive']} decides once, by the first samples alone; to change threshold, "
                "max_samples or adaptive, continue with adaptive = graded"
            )
        # A render may continue with Sobol' points after N-rook patterns, but not with N-rook patterns after Sobol'
        # points. ``shared`` comes from the checkpoint, because its first samples may be those of a shared sequence.
        uses_sobol = state.plan.uses_sobol or self.attributes["uses_sobol"]
        state.plan = replace(state.plan, uses_sobol=uses_sobol, shared=self.attributes["shared"])
        state.noise, state.estimates = self.attributes["noise"], self.attributes["estimates"]
        self.check_arrays(state)
        # Different policies use different numbers of pixels around a crop window.
        _, mine, theirs = np.intersect1d(self.pixels["index"], index(state), True, return_indices=True)
        pixels = {name: np.zeros(len(index(state)), values.dtype) for name, values in self.pixels.items()}
        for name, values in pixels.items():
            values[theirs] = self.pixels[name][mine]
        state.accumulators, state.second_sums = Accumulators.of_arrays(pixels), self.second
        same_target = changed.isdisjoint(TARGETS)
        if decided:
            # The current pass belongs to its target; with another target, the next pass is decided at once.
            state.rounds, state.wanted = self.attributes["rounds"], pixels.get("wanted") if same_target else None
        return decided and self.finished and same_target

    def check_arrays(self, state: Image) -> None:
        """Raises ValueError unless the arrays are those of ``state``, and each pixel is stored once."""
        empty, uint32 = Accumulators.empty(state.estimator.sums_per_pixel, 1), np.dtype(np.uint32)
        needed = types(empty.arrays(slice(1)))
        found = {"wanted": uint32, **types(self.pixels)}
        if found != {**needed, "index": uint32, "wanted": uint32} or types(self.second) not in (needed, {}):
            raise ValueError("these are the samples of another image (the arrays differ); render again")
        if len(np.unique(self.pixels["index"])) < len(self.pixels["index"]):
            raise ValueError("these are the samples of another image (a pixel is stored twice); render again")

    def write(self, path: Path) -> None:
        """Writes the archive to ``path``, and overwrites an older file. Raises OSError."""
        header = {"format": FORMAT, "environment": self.environment, "about": self.about, "attributes": self.attributes}
        groups = (PIXELS, self.pixels), (SECOND, self.second)
        arrays: dict[str, Any] = {prefix + name: values for prefix, group in groups for name, values in group.items()}
        with open(path, "w+b") as file:
            np.savez(file, facts=np.array(json.dumps(header)), **arrays)
            with zipfile.ZipFile(file, "a") as archive:
                archive.comment = digest(archive)


def identity(state: Image) -> dict[str, Any]:
    """Returns the attributes that must be equal in a checkpoint and in the render that continues it."""
    plan, caustics = state.plan, state.estimator.transport.caustics
    return {
        "samples of a pass": plan.n,
        "passes that every pixel gets": plan.sampling.min_passes,
        "jitter": plan.sampling.jitter,
        "photons of a set": None if caustics is None else caustics.count,
        "seed": int(plan.seed[0]),
        "window": plan.window,
        "pixels that have samples": plan.domain,
        "reach of the filter": state.estimator.reach,
        "channels": state.estimator.channels.names,
    }


def index(state: Image) -> np.ndarray:
    """Returns the index of each pixel of ``state`` in ``state.plan.domain``, numbered row by row."""
    left, top, right, _ = state.plan.domain
    x, y = np.array(state.x)[state.own], np.array(state.y)[state.own]
    return ((y - top) * (right - left) + x - left).astype(np.uint32)


def types(named: Mapping[str, np.ndarray]) -> dict[str, np.dtype]:
    """Returns the type of each of the arrays ``named``: name -> type."""
    return {name: values.dtype for name, values in named.items()}


# ---------------------------------------------------------------- files


def save(checkpoint: Checkpoint, path: str | Path) -> None:
    """Writes ``checkpoint``; an older file is replaced only when the new one is complete. Raises OSError."""
    atomic.write({Path(path): checkpoint.write})


def read(path: str | Path, arrays: bool = True) -> Checkpoint:
    """Reads a checkpoint, but does not check the environment in which the checkpoint was made.

    If ``arrays`` is false, only the attributes are read, not the arrays, which saves time. Raises NotACheckpointError
    for a file that is no checkpoint. Raises CheckpointError for another version of the format, and for a damaged or
    incomplete file. Raises OSError if the file cannot be read.
    """
    with open(path, "rb") as file:
        seems_checkpoint = file.read(2) == b"PK"
        try:
            with zipfile.ZipFile(file) as archive:
                names = archive.namelist()
                seems_checkpoint = FACTS in names
                header = json.loads(str(member(archive, FACTS)))
                version = header["format"]
                if version == FORMAT and archive.comment != digest(archive):
                    raise ValueError("another program has changed the archive")
                names = names if arrays and version == FORMAT else []
                pixels, second = (
                    {name[len(group) : -len(NPY)]: member(archive, name) for name in names if name.startswith(group)}
                    for group in (PIXELS, SECOND)
                )
                result = Checkpoint(header["attributes"], pixels, second, header["about"], header["environment"])
                if not (is_integer(version, 1, 10**6) and (version != FORMAT or is_allowed(result))):
                    raise ValueError("a value in the file is not allowed")
        except MemoryError:
            raise CheckpointError(f"{path} needs more memory than there is; use another machine") from None
        except Exception:  # noqa: BLE001  (for damaged data, zipfile, NumPy and json raise exceptions of many kinds)
            if seems_checkpoint:
                raise CheckpointError(f"{path} is damaged or not complete; render again") from None
            raise NotACheckpointError(f"{path} is no checkpoint; give a file by --checkpoint or --part") from None
    if version != FORMAT:
        raise CheckpointError(
            f"{path} has format {version}, and this version reads format {FORMAT}; finish it with the version "
            "that wrote it, or render again"
        )
    return result


def digest(archive: zipfile.ZipFile) -> bytes:
    """Returns a hexadecimal digest of the names, the sizes and the checksums of all members of ``archive``."""
    members = [(info.filename, info.file_size, info.CRC) for info in archive.infolist()]
    return blake2b(repr(members).encode(), digest_size=16).hexdigest().encode()


def is_allowed(checkpoint: Checkpoint) -> bool:
    """Tells whether the attributes of ``checkpoint``, which come from a file, have types and values that this module
    writes, and the arrays of each image have one value per pixel. May raise an exception if not.
    """
    attributes, about, environment = checkpoint.attributes, checkpoint.about, checkpoint.environment
    shapes = [{values.shape for values in group.values()} for group in (checkpoint.pixels, checkpoint.second)]
    return (
        attributes.keys() == ALLOWED.keys()
        and all(ALLOWED[name](value) for name, value in attributes.items())
        and type(about.get("job", {})) is dict
        and type(about.get("digest", "")) is str
        and all(type(environment[name]) is str for name in (*MUST_AGREE, *MAY_DIFFER))
        and all(len(sizes) <= 1 and all(len(shape) == 1 for shape in sizes) for sizes in shapes)
    )


def member(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    """Returns the array ``name``; raises many kinds of exceptions. It is read to its end, for the checksum."""
    info = archive.getinfo(name)
    if info.compress_type != zipfile.ZIP_STORED or not info.file_size == info.compress_size <= archive.start_dir:
        raise zipfile.BadZipFile("a compressed member, or one beyond the end of the file, could be of any size")
    return np.lib.format.read_array(io.BytesIO(archive.read(info)), allow_pickle=False)


def load(path: str | Path) -> Checkpoint:
    """Reads a checkpoint, and checks that this process can continue its render.

    Warns if the checkpoint was made with another processor or LLVM version than this process has. Raises the errors of
    :func:`read`, and CheckpointError if the checkpoint was made by other versions of the software or in another Mitsuba
    variant.
    """
    checkpoint = read(path)
    check_environments({Path(path): checkpoint})
    return checkpoint


def check_environments(checkpoints: Mapping[Path, Checkpoint]) -> None:
    """Checks that this process can continue the renders of all ``checkpoints`` (path -> checkpoint).

    Raises CheckpointError if a checkpoint was made by other versions of the software or in another Mitsuba variant.
    Gives one warning if any checkpoints were made with another processor or LLVM version than this process has.
    """
    elsewhere = []
    for path, checkpoint in checkpoints.items():
        if different := differences(checkpoint.environment, MUST_AGREE):
            raise CheckpointError(
                f"{path} was made elsewhere ({different}), where samples differ; continue it there, or render again"
            )
        if different := differences(checkpoint.environment, MAY_DIFFER):
            elsewhere.append(f"{path} ({different})")
    if elsewhere:
        warnings.warn(
            f"made elsewhere: {'; '.join(elsewhere)}. These samples are as good, but may differ in their last bits "
            "from those that are made here",
            stacklevel=3,
        )


class CheckpointWriter:
    """Writes the checkpoint of a render to ``path`` from time to time.

    If the file cannot be written, the first failure causes a warning, and later failures cause none. ``about`` are the
    caller's attributes, which are stored in each :class:`Checkpoint`.
    """

    #: Minimum seconds between two checkpoints; maximum fraction of the time for writing checkpoints.
    SHORTEST, SHARE = 4.0, 0.02

    def __init__(self, path: Path, about: Mapping[str, Any]) -> None:
        self.path, self.about = path, about
        self.next, self.failed = time.perf_counter() + self.SHORTEST, False

    def __call__(self, render: Any) -> None:
        """Writes a checkpoint of ``render`` if enough time has passed since the last checkpoint.

        Enough time is :attr:`SHORTEST` seconds, or the time that writing the last checkpoint took, divided by
        :attr:`SHARE`, if this is longer. If the file cannot be written, the first failure causes a warning.
        """
        started = time.perf_counter()
        if started < self.next:
            return
        try:
            save(replace(render.checkpoint(), about=self.about), self.path)
        except OSError as error:
            if not self.failed:
                why = f"{self.path}: the checkpoint can't be written: {error.strerror or error}; the render continues"
                warnings.warn(why, stacklevel=2)
            self.failed = True
        end = time.perf_counter()
        self.next = end + max(self.SHORTEST, (end - started) / self.SHARE)


# ---------------------------------------------------------------- parts


def merge(paths: Sequence[str | Path]) -> Checkpoint:
    """Returns the checkpoint of a whole image, merged from the checkpoint files ``paths`` of its parts, in any order.

    Gives one warning if any parts were made with another processor or LLVM version than this process has. Raises the
    errors of :func:`load`, and CheckpointError if a part is missing, given twice, not finished, or of another image.
    """
    parts = {Path(path): read(path, arrays=False) for path in paths}
    check_parts(parts)
    check_environments(parts)
    return put_together(read(path) for path in parts)


def put_together(parts: Iterable[Checkpoint]) -> Checkpoint:
    """Returns the checkpoint of a whole image from the checkpoints of all its finished parts, in any order.

    The result does not have the second image; a render that continues from the result takes the samples of the second
    image again. The attribute ``seconds`` of the result is the sum over the parts; all other attributes are those of
    the first of ``parts``.
    """
    headers, arrays = [], []
    for part in parts:
        headers.append(replace(part, pixels={}, second={}))
        arrays.append(dict(part.pixels))
        if types(arrays[-1]) != types(arrays[0]):
            raise CheckpointError("the parts have different arrays; render them again")
    seconds = sum(header.attributes["seconds"] for header in headers)
    attributes = {**headers[0].attributes, "part": None, "seconds": seconds}
    # The arrays of the parts are released as soon as the array of the image is made.
    pixels = {name: np.concatenate([named.pop(name) for named in arrays]) for name in [*arrays[0]]}
    return replace(headers[0], attributes=attributes, pixels=pixels)


def check_parts(parts: Mapping[Path, Checkpoint]) -> None:
    """Raises CheckpointError unless ``parts`` are all parts of one image, each finished and given once."""
    if not parts:
        raise CheckpointError("no parts are named")
    first_path, first = next(iter(parts.items()))
    for path, checkpoint in parts.items():
        if checkpoint.part is None:
            raise CheckpointError(
                f"{path} is the state of a whole image, not a part of one; continue it by prosim resume"
            )
        mine, theirs = common_attributes(checkpoint), common_attributes(first)
        if different := [f"{k}: {v} here, {theirs.get(k)} there" for k, v in mine.items() if v != theirs.get(k)]:
            raise CheckpointError(f"{path} is not of the image that {first_path} is a part of ({', '.join(different)})")
        if not checkpoint.finished:
            raise CheckpointError(f"{path} is not finished; continue it first: prosim resume {path}")
    of = first.attributes["part"][1]
    paths = {checkpoint.attributes["part"][0]: path for path, checkpoint in parts.items()}
    if twice := [str(path) for path in parts if path not in paths.values()]:
        raise CheckpointError(f"{', '.join(twice)}: another file has the same part; name each part once")
    if missing := [str(number) for number in range(1, of + 1) if number not in paths]:
        raise CheckpointError(f"of {of} parts, these are missing: {', '.join(missing)}")


def common_attributes(checkpoint: Checkpoint) -> dict[str, Any]:
    """Returns the attributes that must be equal in the checkpoints of all parts of one image."""
    attributes, about = checkpoint.attributes, checkpoint.about
    everything = attributes["samples"] | attributes["sampling"] | checkpoint.environment | about.get("job", {})
    return {
        "number of parts": attributes["part"] and attributes["part"][1],
        "content of the scene": about.get("digest", "unknown")[:12],
        **{name: value for name, value in everything.items() if name not in PARTS_MAY_DIFFER},
    }
