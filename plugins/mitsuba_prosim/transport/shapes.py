"""The shapes of a scene."""

from __future__ import annotations

import mitsuba as mi

from ..optics.nested import parts


def all_shapes(scene: mi.Scene) -> list[mi.Shape]:
    """The shapes of ``scene``, and those that it has instances of."""
    shapes = list(scene.shapes())
    if any(shape.class_name() == "Instance" for shape in shapes):
        groups = [part for part in parts(scene).values() if isinstance(part, mi.Shape)]
        shapes += [s for group in groups for s in parts(group).values() if isinstance(s, mi.Shape)]
    return shapes
