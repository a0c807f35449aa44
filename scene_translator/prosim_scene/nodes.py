"""A Mitsuba scene as nested dictionaries, those of ``mi.load_dict``, with comments and defaults for XML."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

#: A plugin: its "type", its parameters, and the plugins in it.
Node = dict[str, Any]


@dataclass(frozen=True)
class Default:
    """The default of a value that Mitsuba's command line sets: ``-D name=value``."""

    name: str
    value: int | float


class Comment(str):
    """A comment before the next element; its key is ignored."""


class Point(list[float]):
    """Three coordinates that XML writes as a point; a plain list is a vector."""


def rgb(color: Iterable[float]) -> Node:
    """A colour."""
    return {"type": "rgb", "value": [float(c) for c in color]}


def rgb_clipped(color: Iterable[float]) -> Node:
    """A reflectance, clipped to 1."""
    return rgb(min(c, 1.0) for c in color)
