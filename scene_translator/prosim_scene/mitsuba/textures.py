"""Translates the textures in the two texture slots of a primitive to Mitsuba's textures.

The first texture slot of a primitive has a pattern or an image in the coordinates (u, v) of the surface. The second
texture slot has a solid texture: a pattern in the coordinates (x, y, z) of the primitive before its TRANSFORM. The
primitive's ambient and diffuse reflectances ka and kd are multiplied by the colours of both textures.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..geometry.solids import matrices
from ..language.words import BUILT_IN, words_of
from ..model import Leaf, Scene, Texture
from ..nodes import Node, rgb, rgb_clipped
from .translation_context import Context

#: Kind of a pattern -> the defaults of its parameters. Colours are factors of ka and kd. Lengths are in (u, v) on a
#: surface, and in the primitive's own space in a solid.
DEFAULTS = {
    kind: {word.name: word.defaults[kind] for word in words_of("PARAMETER") if kind in word.defaults}
    for kind in BUILT_IN.values()
}
#: The default direction across the stripes: v on a surface (False), z (a cylinder's axis) in a solid (True).
STRIPES_AXIS = {False: (0.0, 1.0, 0.0), True: (0.0, 0.0, 1.0)}

COLORS = ("brick", "mortar", "color0", "color1")

#: The warning about diffuse reflectances above 1.
CLIPPED = "kd times a texture is above 1, and is clipped to 1; reduce kd, or the colours of the texture"

#: A function that converts a factor (r, g, b) of a pattern to a colour or to a nested texture.
Colored = Callable[[Sequence[float]], Node]


def parameters(scene: Scene, name: str, solid: bool) -> tuple[str, dict[str, Any]]:
    """Returns the kind of a texture, and the values of all its parameters; parameters that the scene does not state
    have their defaults.

    ``solid`` is True for a solid texture (in the second texture slot); stripes in a solid have another default axis.
    """
    pattern = scene.patterns[name]
    axis = {"axis": STRIPES_AXIS[solid]} if pattern.kind == "stripes" else {}
    return pattern.kind, DEFAULTS[pattern.kind] | axis | dict(pattern.parameters)


def reflectance(
    context: Context, number: int, leaf: Leaf, slots: Sequence[Texture | None], name: str, color: Sequence[float]
) -> Node:
    """Returns the reflectance ``color`` of a primitive multiplied by the primitive's two textures, as an rgb dictionary
    or a (nested) texture.

    The primitive is ``leaf``, node ``number`` of the CSG tree. ``slots`` are the surface texture and the solid texture
    of the primitive, each None if the slot is empty. ``color`` (r, g, b) is the primitive's ambient reflectance or its
    diffuse reflectance, and ``name`` is "ka" or "kd". The products of kd with the colours of patterns are clipped to at
    most 1, with a warning; ka has no limit, because ambient light has no energy.
    """
    surface_texture, solid_texture = slots
    scene = context.scene

    def limited(product: np.ndarray) -> Node:
        if (largest := max(product)) <= 1:
            return rgb(product)
        if name == "ka":  # Mitsuba's colours are at most 1
            return {"type": "prosim_product", "a": float(largest), "b": rgb(np.divide(product, largest))}
        context.warn_once(CLIPPED, "surfaces", leaf.index, "kd", each_line=True)
        return rgb_clipped(product)

    def inner(factor: Sequence[float]) -> Node:
        product = np.multiply(color, factor)
        if solid_texture is None:
            return limited(product)
        node = pattern(scene, solid_texture, True, lambda other_factor: limited(product * other_factor))
        return node | {"solid": True, "to_local": np.linalg.inv(matrices([scene.transforms[leaf.index]])[0])}

    if surface_texture is None:
        return inner((1, 1, 1))
    if surface_texture.image is None:
        return pattern(scene, surface_texture, False, inner)
    image = context.image("bitmap", surface_texture.image, "csg", number, "textures", 0)
    if np.allclose(color, 1) and solid_texture is None:
        return image
    return {"type": "prosim_product", "a": image, "b": inner((1, 1, 1))}


def pattern(scene: Scene, texture: Texture, solid: bool, colored: Colored) -> Node:
    """Returns the dictionary of the texture plugin of a pattern.

    The colours of a pattern are factors of a reflectance; the function ``colored`` converts each factor to a colour or
    a nested texture. The other parameters of the pattern are not changed. ``solid`` is True for a solid texture (in the
    second texture slot).
    """
    assert texture.name is not None
    kind, values = parameters(scene, texture.name, solid)
    values = {key: colored(value) if key in COLORS else value for key, value in values.items()}
    return {"type": "prosim_" + kind} | values
