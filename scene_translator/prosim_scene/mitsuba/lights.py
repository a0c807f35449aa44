"""Translates the statement LIGHTS and the colours of AMBIENT and BACKGROUND; the value 65535 of the scene language
becomes 1.0 in Mitsuba.

The option ``light_units`` of a translation defines the meaning of E = Intensity/65535. In its three values, d is the
distance from the light to VRP (the VIEW's reference point), and r is the radius of the light:

``calibrated``
    E is the irradiance on a surface that faces the light at the distance d; for a cone or a spot, the surface is on the
    axis of the light. So a point has the radiant intensity I = E d^2, a sphere that emits uniformly the radiance L = E
    d^2/(pi r^2), and any other sphere L = E divided by :func:`facing_irradiance`.
``radiance``
    E is the radiance of the light. A point has I = pi r^2 E, as if it were a distant sphere (thesis, section 5.2).
``unattenuated``
    E is the irradiance at any distance from the light; it is less near a narrow beam of an AREA light.
"""

import math
from collections.abc import Sequence

import numpy as np

from ..model import Light, Vector
from ..nodes import Node, Point, rgb
from .translation_context import Context

FULL_SCALE = 65535

#: An AREA light causes no warning of its shadow if its radius is smaller than this fraction of the distance.
SMALL = 0.0999


def from_full_scale(color: Vector) -> tuple[float, ...]:
    """Divides a colour of the scene language by 65535, the language's value for 1.0."""
    return tuple(c / FULL_SCALE for c in color)


def radiance_or_intensity(context: Context, number: int, light: Light, units: str) -> Node:
    """Returns the radiance of an area light, or the intensity of a point light, as the dictionary of a colour, for the
    light units ``units``. Raises SceneError if they are "calibrated" and the light is at VRP or contains it, because
    the irradiance at VRP is then undefined.
    """
    factor = 1.0
    if units == "calibrated":
        d = math.dist(light.position, context.scene.view.vrp)
        if d <= (light.radius if light.kind == "area" else 0):
            where = "contains VRP; make it smaller or move it" if d > 0 else "is at VRP; move it"
            reason = f"this light {where}, or choose other light units than calibrated"
            raise context.document.error(reason, "lights", number)
        factor = d * d if light.kind == "point" else 1 / facing_irradiance(light, d)
    elif light.kind == "point" and units == "radiance":
        factor = math.pi * light.radius * light.radius
    return rgb(factor * c for c in from_full_scale(light.intensity))


def facing_irradiance(light: Light, distance: float) -> float:
    """Returns the irradiance that a spherical light, whose radiance is 1 along its axis, causes on a surface that faces
    the light.

    The surface is on the axis of the light, at ``distance`` (more than the radius) from the light's centre. A ray at
    the angle t to the axis has the radiance cos^n t (n is a spot's exponent, or else 0), so the irradiance is the
    integral of 2 pi cos^(n+1) t sin t dt from t = 0 to the angular radius of the sphere, or the ``angle`` of a cone or
    spot, if smaller.
    """
    n = light.exponent if light.distribution == "spot" else 0.0
    sine2 = (light.radius / distance) ** 2
    if light.distribution != "uniform" and light.angle is not None and light.angle < 90:
        sine2 = min(sine2, math.sin(math.radians(light.angle)) ** 2)
    return -2 * math.pi * math.expm1((n + 2) / 2 * math.log1p(-sine2)) / (n + 2)


def warn_of_radius(context: Context, number: int, light: Light) -> None:
    """Warns if the scene states the radius of a point light that has no effect with these light units."""
    path = "lights", number, "radius"
    if light.kind == "point" and context.options.light_units != "radiance" and context.document.is_given(*path):
        word = context.document.text_of(*path)
        context.document.warn(f"a POINT light has a {word} only with light units 'radiance'; delete it", *path)


def warn_of_hidden_lights(context: Context, corners: Sequence[np.ndarray]) -> None:
    """Warns of AREA lights that shade a surface from another light, as bodies in Mitsuba, but not in the thesis.
    ``corners`` (n, 3, 3) are those of each mesh.
    """
    document, scene = context.document, context.scene
    kinds = {number: light for number, light in enumerate(scene.lights) if light.kind != "sky"}
    areas = {number: light for number, light in kinds.items() if light.kind == "area"}
    if not scene.shadows or not areas or len(kinds) < 2:
        return
    hidden: dict[int, list[str]] = {}
    for number, light in kinds.items():
        # The edges of each triangle, as seen from the light: a ray on the same side of all three meets the triangle.
        seen = [each - np.array(light.position) for each in corners]
        edges = [(each[:, 0], np.cross(each, np.roll(each, -1, axis=1))) for each in seen]
        for front, area in areas.items():
            if front != number and hides(area, light, edges):
                name = f"{light.kind.upper()} in line {document.line('lights', number)}"
                hidden.setdefault(front, []).append(name)
    for front, names in hidden.items():
        reason = f"this light shades surfaces from {', '.join(names)}, because an AREA light is a body; "
        document.warn(f"{reason}move it, or make it smaller or a POINT light", "lights", front)


def hides(area: Light, light: Light, edges: Sequence[tuple[np.ndarray, np.ndarray]]) -> bool:
    """Whether the sphere of ``area`` shades a triangle from the centre of ``light``; also whether ``light`` is inside
    the sphere.

    A sphere that is smaller than :data:`SMALL` shades nothing. The function tests the corners of the triangles, and
    five rays: through the centre of the sphere, and near its outline. ``edges`` are, for each mesh, the first corner
    (n, 3) of each triangle relative to ``light``, and the normals (n, 3, 3) of the planes through ``light`` and the
    edges.
    """
    axis = np.subtract(area.position, light.position)
    distance = float(np.linalg.norm(axis))
    inside = light.kind == "area" and light.radius >= distance + area.radius
    if inside or area.radius < SMALL * distance:
        return False
    if distance <= area.radius:
        return True
    cosine = math.sqrt(1 - (area.radius / distance) ** 2)
    across = np.linalg.svd(axis[None] / distance)[2][1:]
    rays = axis + 0.9 * area.radius * cosine * np.array([np.zeros(3), *across, *-across])
    rays = rays[in_beam(light, rays)]
    for corners, normals in edges:
        far = np.linalg.norm(corners, axis=1)
        if np.any((corners @ axis > cosine * distance * far) & (far > distance) & in_beam(light, corners)):
            return True
        sides = normals @ rays.T
        met = np.all(sides > 0, axis=1) | np.all(sides < 0, axis=1)
        with np.errstate(all="ignore"):  # triangles that are parallel to the ray
            distances = np.sum(corners * normals.sum(axis=1), axis=1)[:, None] / sides.sum(axis=1)
        if np.any(met & (distances > 1)):  # behind the middle of the sphere
            return True
    return False


def in_beam(light: Light, vectors: np.ndarray) -> np.ndarray:
    """Whether ``light`` emits in the direction of each of the ``vectors`` (n, 3); a mask (n,)."""
    if light.distribution == "uniform":
        return np.ones(len(vectors), bool)
    limit = math.cos(math.radians(90 if light.angle is None else light.angle))
    length = np.linalg.norm(vectors, axis=1) * float(np.linalg.norm(light.direction))
    return np.asarray(vectors @ light.direction >= limit * length)


def sky_emitter(context: Context, number: int, light: Light) -> Node:
    """Returns the environment emitter of a SKY light."""
    return context.image("envmap", light.image or "", "lights", number, "image")


def emitter(prefix: str, light: Light, color: Node, parameters: Node) -> Node:
    """Returns the emitter of a POINT light, or the black sphere of an AREA light: the plugin ``prefix`` + kind, with
    ``color`` and ``parameters``.
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
