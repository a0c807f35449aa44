"""LIGHTS, AMBIENT and BACKGROUND: 65535 is 1.0.

``light_units`` says what Intensity means; E is Intensity/65535, d the distance from the source to VRP, r its radius:

``calibrated``
    E is the irradiance on a surface that faces the source at VRP: L = E d^2/(pi r^2), and I = E d^2 for a point.
``radiance``
    E is the radiance itself; I = pi r^2 E for a point, whose radius is virtual (5.2).
``unattenuated``
    E is the irradiance at any distance.
"""

import math

from ..model import Light, Vector
from ..nodes import Node, Point, rgb
from .context import Context

FULL_SCALE = 65535
UNITS = ("calibrated", "radiance", "unattenuated")


def radiometric(color: Vector) -> tuple[float, ...]:
    """Intensities of the language in units of 1.0."""
    return tuple(c / FULL_SCALE for c in color)


def quantity(context: Context, number: int, light: Light, units: str) -> tuple[float, ...]:
    """Radiance of an area light, intensity of a point light."""
    e = radiometric(light.intensity)
    disc = math.pi * light.radius**2
    factor = 1.0
    if units == "calibrated":
        d = math.dist(light.position, context.scene.view.vrp)
        if d == 0:
            raise context.document.error("this light stands at VRP, where light units 'calibrated' measure its irradiance; "
                                         "expected another place, or other light units", "lights", number)
        factor = d * d / (disc if light.kind == "area" else 1)
    elif light.kind == "point" and units == "radiance":
        factor = disc
    return tuple(factor * c for c in e)


def emitter(context: Context, number: int, light: Light, units: str) -> Node:
    """An emitter of this project's, or for an area light the sphere that bears it."""
    node: Node = {"type": "prosim_" + light.kind}
    if light.kind == "point":
        node["position"] = Point(light.position)
    node["radiance" if light.kind == "area" else "intensity"] = rgb(quantity(context, number, light, units))
    if light.distribution != "uniform":
        node |= {"distribution": light.distribution, "direction": list(light.direction)}
        if light.angle is not None:
            node["angle"] = light.angle
        if light.distribution == "spot":
            node["exponent"] = light.exponent
    if units == "unattenuated":
        node["unattenuated"] = True
    return sphere(light, node) if light.kind == "area" else node


def sphere(light: Light, emitter: Node) -> Node:
    """The body of an area light: it emits, and reflects nothing."""
    return {"type": "sphere", "center": Point(light.position), "radius": light.radius,
            "bsdf": {"type": "diffuse", "reflectance": rgb((0, 0, 0))}, "emitter": emitter}
