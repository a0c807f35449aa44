"""A Mitsuba scene as nested dictionaries, those of ``mi.load_dict``, with comments and defaults for XML."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

#: A plugin: its "type", its parameters, and the plugins in it.
Node = dict[str, Any]


@dataclass(frozen=True)
class Default:
    """A value that the user can set on Mitsuba's command line: ``-D name=value``."""

    name: str
    value: int | float


class Comment(str):
    """A comment that goes before the next element; its key does not matter."""


class Point(list[float]):
    """Three coordinates that the XML writes as a point, where a plain list is a vector."""


def rgb(color: Iterable[float]) -> Node:
    """A colour."""
    return {"type": "rgb", "value": [float(c) for c in color]}


def rgb_clipped(color: Iterable[float]) -> Node:
    """A reflectance, which may not exceed 1, whatever a texture's factor."""
    return rgb(min(c, 1.0) for c in color)
