"""Texture slots -> Mitsuba textures.

Slot 1 is a pattern or an image on the surface parameters (u, v), slot 2 a pattern in the primitive's own space, a
solid. Both modulate ka and kd: a pattern's colours are factors of these, slot 1's of slot 2's.
"""

import numpy as np

from .reader import BUILT_IN

#: Defaults of the patterns: factors of ka and kd, and lengths in (u, v) or in the primitive's own space.
DEFAULTS = {
    # 12 bricks with their joints along u, 26 rows along v: no seam.
    "brick": {"brick": (1.0, 0.7, 0.6), "mortar": (1.4, 1.5, 1.8), "brick_width": 1 / 12 - 1 / 250,
              "brick_height": 1 / 26 - 1 / 250, "mortar_width": 1 / 250, "stagger": 0.5},
    "stripes": {"color0": (1.0, 1.0, 1.0), "color1": (0.35, 0.35, 0.35), "frequency": 6.0, "duty": 0.5},
    "fractal": {"color0": (0.5, 0.5, 0.5), "color1": (1.2, 1.2, 1.2), "scale": 4.0, "octaves": 6, "gain": 0.5,
                "lacunarity": 2.0, "seed": 0},
}
#: Across the stripes: along v on a surface, along z (a cylinder's axis) in a solid.
STRIPES_AXIS = {False: (0.0, 1.0, 0.0), True: (0.0, 0.0, 1.0)}

COLORS = ("brick", "mortar", "color0", "color1")


def parameters(scene, name, solid):
    """Kind and complete parameters of a texture."""
    pattern = scene.patterns.get(name)
    kind = pattern.kind if pattern else BUILT_IN[name]
    values = dict(DEFAULTS[kind])
    if kind == "stripes":
        values["axis"] = STRIPES_AXIS[solid]
    if pattern:
        values |= dict(pattern.parameters)
    return kind, values


def rgb(color):
    return {"type": "rgb", "value": [float(c) for c in color]}


def reflectance(scene, color, slots, to_local, images):
    """The colour of a surface with its two texture slots applied: an rgb or a (nested) texture.

    ``images`` maps a :class:`~prosim_scene.model.Texture` to the file name that stands in the XML.
    """
    first, second = slots
    if second is not None:
        inner = color

        def color_node(factor):
            return pattern(scene, second, [a * b for a, b in zip(inner, factor)], True, to_local, rgb_clipped)
    else:
        def color_node(factor):
            return rgb_clipped([a * b for a, b in zip(color, factor)])
    if first is None:
        return color_node((1, 1, 1))
    if first.image:
        image = {"type": "bitmap", "filename": images(first)}
        if np.allclose(color, 1) and second is None:
            return image
        return {"type": "prosim_product", "a": image, "b": color_node((1, 1, 1))}
    return pattern(scene, first, (1, 1, 1), False, None, color_node)


def rgb_clipped(color):
    """A reflectance may not exceed 1, whatever a texture's factor."""
    return rgb([min(c, 1.0) for c in color])


def pattern(scene, texture, factor, solid, to_local, color_node):
    kind, values = parameters(scene, texture.name, solid)
    node = {"type": "prosim_" + kind}
    for key, value in values.items():
        node[key] = color_node([a * b for a, b in zip(value, factor)]) if key in COLORS else value
    if solid:
        node |= {"solid": True, "to_local": to_local}
    return node
