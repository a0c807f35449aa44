"""An image put together from its parts."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..engine.part import Part
from ..engine.record import Record
from . import origin
from .files import StateError, about, load

#: What parts may differ in: it says where they were made, not of what.
FREE = ("scene", "exposure", "LLVM", "processor")


def merge(paths: Sequence[str | Path]) -> Record:
    """The record of the image of which all parts are in the files ``paths``, in any order. One part is read at a time.
    Warns, once, where some come from other kinds of processors.

    Raises StateError where a part is missing, there twice, not finished, or of another image; and as :func:`.load`.
    """
    check(paths)
    ours = origin.here()
    elsewhere = [where for path in paths if (where := origin.differences(about(path)["origin"], ours, origin.CLOSE))]
    if elsewhere:
        warnings.warn(
            f"{len(elsewhere)} of {len(paths)} parts were made elsewhere ({'; '.join(dict.fromkeys(elsewhere))}): "
            "their samples are as good, but may differ in their last bits from those that are made here",
            stacklevel=2,
        )
    return put_together(load(path, warn=False) for path in paths)


def put_together(parts: Iterable[Record]) -> Record:
    """The record of the image of which these are all parts, in any order; they are looked at one by one."""
    result: Record | None = None
    seconds = 0.0
    for record in parts:
        part, tiles = record.part, record.tiles
        assert part is not None and tiles is not None
        left, top, right, bottom = record.facts["known"]
        y, x = np.ogrid[top:bottom, left:right]
        mine = tiles.owned(part, x, y)
        if result is None:
            result = replace(record, pixels={name: np.zeros_like(plane) for name, plane in record.pixels.items()})
        for name, plane in result.pixels.items():
            np.copyto(plane, record.pixels[name], where=mine)
        seconds += record.facts["seconds"]
    assert result is not None
    return replace(result, facts={**result.facts, "part": None, "tiles": None, "seconds": seconds})


def check(paths: Sequence[str | Path]) -> None:
    """Sees, before anything large is read, whether the files are all parts of one image, each once.

    Raises StateError, OSError.
    """
    if not paths:
        raise StateError("no parts are named")
    first, found = about(paths[0]), dict[Part, Path]()
    for path in map(Path, paths):
        text = about(path)
        if not text["facts"]["part"]:
            raise StateError(f"{path} is the state of a whole image, not a part of one; prosim resume goes on with it")
        if first["facts"]["part"] and (different := difference(text, first)):
            raise StateError(f"{path} is not of the image that {paths[0]} is a part of ({different})")
        part = Part(*text["facts"]["part"])
        if part in found:
            raise StateError(f"{path} is part {part}, as {found[part]} is already; name each part once")
        if not text["facts"]["finished"]:
            raise StateError(f"{path} is not finished; go on with it first: prosim resume {path}")
        found[part] = path
    of = part.of
    if missing := [str(number) for number in range(1, of + 1) if Part(number, of) not in found]:
        names = f"part {missing[0]} is" if len(missing) == 1 else f"parts {', '.join(missing)} are"
        raise StateError(f"of {of} parts, {names} missing")


def difference(text: dict[str, Any], other: dict[str, Any]) -> str:
    """In what two parts differ that makes them parts of different images, in words; empty where in nothing."""

    def said(text: dict[str, Any]) -> dict[str, Any]:
        facts, of = text["facts"], text["about"]
        everything = facts["samples"] | facts["sampling"] | text["origin"] | of.get("job", {})
        return {
            "number of parts": facts["part"][1],
            "content of the scene": of.get("digest", "unknown")[:12],
            **{name: value for name, value in everything.items() if name not in FREE},
        }

    mine, theirs = said(text), said(other)
    return ", ".join(
        f"{name}: {mine[name]} here, {theirs.get(name)} there" for name in mine if mine[name] != theirs.get(name)
    )
