"""Angular distributions of a source's intensity (section 5.2, figure 5.6): uniform, cone, spot.

A cone of half-opening alpha is the constant 1 for beta <= alpha; a spot is cos^n(beta), cut off at alpha (90 degrees by
default). beta is the angle between the source's direction and that of the light. Both are described by the versines of
the angles, 1 - cos, which stay precise in narrow beams, and by the exponent n, which is None for a cone.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..optics import cosine
from ..parameters import choice, number, reject

#: Values of the parameter ``distribution``, and the further parameters of each.
PARAMETERS = {"uniform": (), "cone": ("direction", "angle"), "spot": ("direction", "angle", "exponent")}


def falloff(versine: mi.Float, limit: mi.Float, exponent: mi.Float | None = None) -> mi.Float:
    """Intensity over that on the axis, in [0, 1]."""
    inside = dr.minimum(versine, 2) <= limit
    return dr.select(inside, mi.Float(1) if exponent is None else cosine.power(versine, exponent), mi.Float(0))


def total(limit: mi.Float, exponent: mi.Float | None = None) -> mi.Float:
    """Integral of `falloff` over all directions, in steradians."""
    return dr.two_pi * (limit if exponent is None else cosine.share(limit, exponent) / (exponent + 1))


def sample_falloff(sample2: mi.Point2f, limit: mi.Float, exponent: mi.Float | None = None) -> mi.Vector3f:
    """Draws a direction about the z axis with density `falloff` / `total`."""
    if exponent is None:
        p = mi.warp.square_to_uniform_disk_concentric(sample2)
        versine = limit * dr.squared_norm(p)
        p *= dr.safe_sqrt(limit * (2 - versine))
        return mi.Vector3f(p.x, p.y, 1 - versine)
    sin, cos = cosine.sample(sample2.x * cosine.share(limit, exponent), exponent)
    sin_phi, cos_phi = dr.sincos(dr.two_pi * sample2.y)
    return mi.Vector3f(sin * cos_phi, sin * sin_phi, cos)


@dataclass
class Beam:
    """The distribution of a source about its axis; None where it has no such parameter."""

    distribution: str  #: one of `PARAMETERS`
    direction: mi.Vector3f | None  #: the axis, in world coordinates and of any length
    angle: mi.Float | None  #: in degrees
    exponent: mi.Float | None

    @property
    def uniform(self) -> bool:
        """Whether the source sends the same in every direction."""
        return self.angle is None

    def limit(self) -> mi.Float:
        """Versine of the angle beyond which there is no light."""
        return 2 * dr.square(dr.sin(0.5 * dr.deg2rad(self.angle)))

    def towards(self, d: mi.Vector3f) -> mi.Float:
        """Intensity in the unit direction ``d``, over that on the axis."""
        if self.uniform:
            return mi.Float(1)
        return falloff(cosine.versine(d, dr.normalize(self.direction)), self.limit(), self.exponent)

    def sample(self, sample2: mi.Point2f) -> tuple[mi.Vector3f, mi.Float]:
        """Draws a direction of light in proportion to the intensity: ``(d, total)``, `total` as above."""
        if self.uniform:
            return mi.warp.square_to_uniform_sphere(sample2), mi.Float(4 * dr.pi)
        local = sample_falloff(sample2, self.limit(), self.exponent)
        d = mi.Frame3f(dr.normalize(self.direction)).to_world(local)
        return d, total(self.limit(), self.exponent)

    def make_opaque(self) -> None:
        """Keeps the values out of the kernels' code."""
        dr.make_opaque(self.direction, self.angle, self.exponent)


def read_beam(props: mi.Properties) -> Beam:
    """Reads ``distribution``, ``direction``, ``angle`` and ``exponent`` of a plugin.

    Raises ValueError for missing or wrong parameters, and for those without effect.
    """
    name = choice(props, "distribution", tuple(PARAMETERS))
    spot = name == "spot"
    for parameter in PARAMETERS["spot"]:
        if parameter in props and parameter not in PARAMETERS[name]:
            raise reject(props, parameter, props[parameter], f'no "{parameter}" with distribution {name}')
    if name == "uniform":
        return Beam(name, None, None, None)
    direction = mi.ScalarVector3f(props.get("direction", mi.ScalarVector3f(0, -1, 0)))
    if not 0 < dr.norm(direction) < float("inf"):
        raise reject(props, "direction", list(direction), "a vector of finite length > 0")
    angle = number(props, "angle", 90.0 if spot else None, 0, 90 if spot else 180, open_below=True)
    exponent = number(props, "exponent", None, 0) if spot else None
    beam = Beam(name, mi.Vector3f(direction), mi.Float(angle), None if exponent is None else mi.Float(exponent))
    beam.make_opaque()
    return beam
