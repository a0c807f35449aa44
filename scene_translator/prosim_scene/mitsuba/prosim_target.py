"""Translates a scene for the target ``prosim``, which uses the plugins of this project."""

from ..model import Leaf, Light
from ..nodes import Comment, Default, Node, rgb
from . import lights, materials
from .translation_context import Context

SAMPLER, LENS = "nrook", "prosim_window"


def settings(context: Context) -> Node:
    """Returns the integrator ``prosim``, and a comment that lists the statements of its settings."""
    scene = context.scene
    background = rgb(lights.from_full_scale(scene.background.color))
    if scene.background.image is not None:
        background = context.image("bitmap", scene.background.image, "background", "image")
    # The parameter `caustics` is written only if the scene has CAUSTICS.
    word, caustics = (", CAUSTICS", {"caustics": True}) if scene.caustics else ("", {})
    stated = {name: getattr(scene.method, name) for name in ("adaptive", "threshold", "cutoff")}
    method = {name: value for name, value in stated.items() if value is not None}
    word += ", METHOD" if method else ""
    return {
        "comment": Comment(f"{scene.name}: SAVE-RGB, MAX-LEVEL, NSAMPLES, DO-SHADOW{word}, AMBIENT, BACKGROUND"),
        "integrator": {
            "type": "prosim",
            "samples": Default("samples", context.samples),
            "max_level": scene.max_level,
            "shadows": scene.shadows,
            **caustics,
            **method,
            "ambient": rgb(lights.from_full_scale(scene.ambient)),
            "background": background,
            "hide_emitters": True,
            "channels": "".join(c for c, saved in zip("rgb", scene.channels, strict=True) if saved),
        },
    }


def light(context: Context, number: int, light: Light) -> Node:
    """Returns the dictionary of the emitter of a POINT light, or of the sphere of an AREA light, which contains the
    emitter.

    The emitter has a direction and an angle only for the distributions CONE and SPOT, and an exponent only for SPOT.
    """
    units = context.options.light_units
    parameters: Node = {}
    if light.distribution != "uniform":
        parameters = {"distribution": light.distribution, "direction": list(light.direction)}
        if light.angle is not None:
            # The intensity of a SPOT, cos^n, is 0 beyond 90 degrees.
            parameters["angle"] = min(light.angle, 90.0) if light.distribution == "spot" else light.angle
        if light.distribution == "spot":
            parameters["exponent"] = light.exponent
    if units == "unattenuated":
        parameters["unattenuated"] = True
    return lights.emitter("prosim_", light, lights.radiance_or_intensity(context, number, light, units), parameters)


def surface(context: Context, number: int, leaf: Leaf, sides: materials.MediumInterface) -> Node:
    """Returns the BSDF of a primitive, and the absorbing media on both sides of its surface."""
    return {"bsdf": materials.bsdf(context, number, leaf, sides), **materials.media(context, sides)}
