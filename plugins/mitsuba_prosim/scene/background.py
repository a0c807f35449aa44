"""Makes the background of an integrator an emitter of the scene."""

from __future__ import annotations

import mitsuba as mi

from ..optics import nested


def with_background_emitter(scene: mi.Scene, background: mi.Texture) -> mi.Scene:
    """Returns a new scene with the same shapes and emitters, with ``background`` as a further emitter, without a
    sensor.

    The objects are not copied, because Dr.Jit traces all BSDFs and emitters that exist. Raises ValueError if the
    background varies in space and is not a bitmap.
    """
    if background.is_spatially_varying() and "data" not in mi.traverse(background):
        raise ValueError(
            f"a background of {background.class_name()} can't light the scene for other integrators; use a colour or a "
            "bitmap"
        )
    sky = {"type": "constant", "radiance": background}
    if background.is_spatially_varying():
        sky = {"type": "envmap", "bitmap": mi.Bitmap(mi.traverse(background)["data"])}
    shapes = [*scene.shapes(), *(part for part in nested.parts(scene).values() if isinstance(part, mi.Shape))]
    parts = {f"shape_{i}": shape for i, shape in enumerate(dict.fromkeys(shapes))}  # also the groups of instances
    parts |= {f"emitter_{i}": emitter for i, emitter in enumerate(scene.emitters()) if emitter.get_shape() is None}
    names = {part: part.id() for part in parts.values()}
    try:
        return mi.load_dict({"type": "scene", **parts, "background": sky})
    finally:
        for part, name in names.items():  # load_dict has renamed the objects
            part.set_id(name)
