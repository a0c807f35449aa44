"""The parts of BSDFs and scenes: BSDFs within BSDFs, shapes within instances."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import Any

import mitsuba as mi

from ..compat import INSTANCE


@functools.cache
def _callback(variant: str) -> type:
    """The class that collects the values that an object exposes, for the active variant.

    One class for all calls: each would be garbage with a reference to that, until Python collects it.
    """

    class Parts(mi.TraversalCallback):
        def __init__(self) -> None:
            super().__init__()
            self.found: dict[str, Any] = {}

        def put(self, name: str, value: Any, flags: Any, *_: Any) -> None:
            self.found[name] = value

    return Parts


def parts(thing: mi.Object) -> dict[str, Any]:
    """The parts of ``thing``, a BSDF or an emitter, by their names in ``mi.traverse``: BSDFs, textures,
    numbers.
    """
    callback = _callback(mi.variant())()
    thing.traverse(callback)
    return callback.found


def all_within(bsdf: mi.BSDF) -> Iterator[mi.BSDF]:
    """``bsdf`` and all BSDFs within it, at any depth."""
    yield bsdf
    for part in parts(bsdf).values():
        if isinstance(part, mi.BSDF):
            yield from all_within(part)


def all_shapes(scene: mi.Scene) -> list[mi.Shape]:
    """The shapes of ``scene``, and those that it has instances of."""
    shapes = list(scene.shapes())
    if any(shape.class_name() == INSTANCE for shape in shapes):
        groups = [part for part in parts(scene).values() if isinstance(part, mi.Shape)]
        shapes += [s for group in groups for s in parts(group).values() if isinstance(s, mi.Shape)]
    return shapes
