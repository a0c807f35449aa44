"""A record of an image on its way as an OpenEXR file, and back."""

from __future__ import annotations

import errno
import json
import warnings
import zlib
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from ..engine.record import Record
from ..scene import atomic
from . import origin

#: Names of the attributes that hold all that is no pixels, and the CRC-32 of this; the number of this way to write it.
ATTRIBUTE, SUM, FORMAT = "prosim.state", "prosim.state.checksum", 6

#: What there is one of for each of some pixels is folded into rows of so many.
FOLD = 1024


class StateError(ValueError):
    """A file that can't be gone on with."""


class NoStateError(StateError):
    """A file that is of another kind altogether."""


def save(record: Record, path: str | Path) -> None:
    """Writes ``record``, which takes the place of what was there when it is complete.

    Raises OSError.
    """
    atomic.write({Path(path): partial(put, record)})


def put(record: Record, path: Path) -> None:
    """Writes the content of the file, plane by plane. Its pixels are not compressed, as that would take long; the
    pixels of a part that are another's, all zero, take next to no room.

    Raises OSError.
    """
    groups = {
        "pixels": record.pixels,
        "twin": {name: folded(values) for name, values in record.twin.items()},
        "image": record.image,
    }
    left, top, right, bottom = record.facts["known"]
    window = (np.array([left, top], np.int32), np.array([right - 1, bottom - 1], np.int32))
    text = {
        "format": FORMAT,
        "origin": origin.here(),
        "about": dict(record.about),
        "facts": dict(record.facts),
        "twin": len(next(iter(record.twin.values()), ())),
        "checksum": checksum(groups.values()),
    }
    compression = OpenEXR.RLE_COMPRESSION if record.part else OpenEXR.NO_COMPRESSION
    parts = []
    for name, planes in groups.items():
        if planes:
            header = {"type": OpenEXR.scanlineimage, "compression": compression, "displayWindow": window}
            if name == "pixels":
                header |= {"dataWindow": window, **attributes(text)}
            parts.append(OpenEXR.Part(header, {k: np.ascontiguousarray(v) for k, v in planes.items()}, name))
    try:
        OpenEXR.File(parts).write(str(path))
    except RuntimeError as error:  # which names the file and says why
        raise OSError(errno.EIO, str(error)) from None


def attributes(text: Mapping[str, Any]) -> dict[str, str]:
    """All that is no pixels, as attributes of the file."""
    said = json.dumps(text)
    return {ATTRIBUTE: said, SUM: str(zlib.crc32(said.encode()))}


def about(path: str | Path) -> dict[str, Any]:
    """What is known of a state beside its pixels: ``about``, ``origin`` and ``facts``.

    Raises NoStateError where that is no state, StateError for one of another version of this program, or one that is
    damaged or not whole; OSError.
    """
    path = Path(path)
    size = path.stat().st_size  # whose error is kinder than OpenEXR's
    try:
        header = OpenEXR.File(str(path), header_only=True).parts[0].header
        said = header[ATTRIBUTE]
        text: dict[str, Any] = json.loads(said)
        number = text["format"]
    except (RuntimeError, ValueError, KeyError, TypeError):
        raise NoStateError(
            f"{path} is no state of a render, or a part of one; what --keep and --part write is"
        ) from None
    if number != FORMAT:
        raise StateError(
            f"{path} has format {number}, and this version reads format {FORMAT}, whose samples are others; finish it "
            "with the version that wrote it, or render again"
        )
    if header.get(SUM) != str(zlib.crc32(said.encode())):
        raise StateError(f"{path} is damaged: what it says of itself is not what was written")
    left, top, right, bottom = text["facts"]["known"]
    if text["facts"]["part"] is None and size < 4 * len(header["channels"]) * (right - left) * (bottom - top):
        raise StateError(f"{path} is not whole")
    return text


def load(path: str | Path, warn: bool = True) -> Record:
    """Reads what :func:`save` has written, and warns where it comes from another kind of processor, unless not told to.

    Raises StateError where the file is no state, is not whole, or was made by other versions or in another variant;
    OSError.
    """
    text, ours = about(path), origin.here()
    if different := origin.differences(text["origin"], ours, origin.EXACT):
        raise StateError(
            f"{path} was made elsewhere ({different}), and samples are the same only where these are; render anew, or "
            "go on with what made it"
        )
    if warn and (different := origin.differences(text["origin"], ours, origin.CLOSE)):
        warnings.warn(
            f"{path} was made elsewhere ({different}): what is added now is as good, but may differ in its last bits "
            "from what would have been added there",
            stacklevel=2,
        )
    try:
        parts = OpenEXR.File(str(path), separate_channels=True).parts
        groups = {part.name() or "pixels": {k: c.pixels for k, c in part.channels.items()} for part in parts}
        whole = checksum(groups.get(name, {}) for name in ("pixels", "twin", "image")) == text["checksum"]
    except (RuntimeError, ValueError, AttributeError):
        whole = False
    if not whole:
        raise StateError(f"{path} is damaged: its values are not those that were written")
    twin = {name: values.ravel()[: text["twin"]] for name, values in groups.get("twin", {}).items()}
    return Record(text["facts"], groups["pixels"], twin, groups.get("image", {}), text["about"])


def folded(values: np.ndarray) -> np.ndarray:
    """A row as several of :data:`FOLD`, the last filled up with zeros."""
    rows = max(1, -(-len(values) // FOLD))
    return np.pad(values, (0, rows * FOLD - len(values))).reshape(rows, FOLD)


def checksum(groups: Iterable[Mapping[str, np.ndarray]]) -> int:
    """CRC-32 of all arrays, in the order of their names within each group."""
    result = 0
    for group in groups:
        for name in sorted(group):
            result = zlib.crc32(np.ascontiguousarray(group[name]).data, result)
    return result
