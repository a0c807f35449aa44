"""Translates LIGHTS, AMBIENT and BACKGROUND; the value 65535 of the language is 1.0.

The option ``light_units`` of a translation defines the meaning of a light's Intensity. E is Intensity/65535, d is the
distance from the light to VRP (the VIEW's reference point), r is the radius of the light:

``calibrated``
    E is the irradiance on a surface that faces the light at the distance d, on the axis of a cone or a spot. A point
    has the intensity I = E d^2. A sphere that emits uniformly has the radiance L = E d^2/(pi r^2). For another sphere,
    L is E divided by the integral, over the solid angle of the sphere, of the angular falloff times the cosine.
``radiance``
    E is the radiance of the light. A point has the intensity I = pi r^2 E; its radius r is virtual (thesis, section
    5.2).
``unattenuated``
    E is the irradiance at any distance from the light.
"""

import math

from ..model import Light, Vector
from ..nodes import Node, Point, rgb
from .translation_context import Context

FULL_SCALE = 65535


def from_full_scale(color: Vector) -> tuple[float, ...]:
    """Divides a colour of the language by its full scale, 65535."""
    return tuple(c / FULL_SCALE for c in color)


def radiance_or_intensity(context: Context, number: int, light: Light, units: str) -> Node:
    """Returns the radiance of an area light, or the intensity of a point light, as the dictionary of a colour.

    ``units`` defines the meaning of the light's Intensity: "calibrated", "radiance" or "unattenuated". Raises
    SceneError for a calibrated light at VRP.
    """
    factor = 1.0
    if units == "calibrated":
        d = math.dist(light.position, context.scene.view.vrp)
        if d <= (light.radius if light.kind == "area" else 0):
            reason = "this light is at VRP, where light units 'calibrated' define its irradiance; "
            reason += "expected another position, or other light units"
            raise context.document.error(reason, "lights", number)
        factor = d * d if light.kind == "point" else 1 / facing_irradiance(light, d)
    elif light.kind == "point" and units == "radiance":
        factor = math.pi * light.radius * light.radius
    return rgb(factor * c for c in from_full_scale(light.intensity))


def facing_irradiance(light: Light, distance: float) -> float:
    """Returns the irradiance that a spherical light, whose radiance is 1 along its axis, causes on a facing surface.

    The surface is on the axis of the light, at ``distance`` from its centre. A ray at the angle t to the axis has the
    radiance cos^n t, so the irradiance is the integral of 2 pi cos^(n+1) t sin t dt over the sphere. If the cone of the
    light is narrower than the sphere, the integral is over the cone.
    """
    n = light.exponent if light.distribution == "spot" else 0.0
    sine2 = (light.radius / distance) ** 2
    if light.angle is not None and light.angle < 90:
        sine2 = min(sine2, math.sin(math.radians(light.angle)) ** 2)
    return -2 * math.pi * math.expm1((n + 2) / 2 * math.log1p(-sine2)) / (n + 2)


def warn_of_radius(context: Context, number: int, light: Light) -> None:
    """Warns if the virtual radius of a point light has no effect."""
    path = "lights", number, "radius"
    if light.kind == "point" and context.options.light_units != "radiance" and context.document.is_given(*path):
        reason = "raio has an effect on a POINT light only with light units 'radiance'; delete it"
        context.document.warn(reason, *path)


def sky_emitter(context: Context, number: int, light: Light) -> Node:
    """Returns the environment emitter of a SKY light."""
    return context.image("envmap", light.image or "", "lights", number, "image")


def emitter(prefix: str, light: Light, color: Node, parameters: Node) -> Node:
    """Returns the emitter of a POINT light, or the sphere of an AREA light, which emits light and reflects none.

    ``prefix`` and the kind of the light are the name of the emitter's plugin. ``color`` is its radiance or intensity,
    ``parameters`` are its other parameters.
    """
    plugin = prefix + light.kind
    if light.kind == "point":
        return {"type": plugin, "position": Point(light.position), "intensity": color, **parameters}
    return {
        "type": "sphere",
        "center": Point(light.position),
        "radius": light.radius,
        "bsdf": {"type": "diffuse", "reflectance": rgb((0, 0, 0))},
        "emitter": {"type": plugin, "radiance": color, **parameters},
    }
