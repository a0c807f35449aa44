"""Data of a ray of a ray tree or path, and of the surface point that the ray meets."""

from __future__ import annotations

from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi

from ..light.strategy import Receiver


@dataclass
class Ray:
    """A ray of a tree or path. All fields are Dr.Jit arrays of one width, or None if not needed."""

    o: mi.Point3f
    d: mi.Vector3f
    #: Factor from the radiance of this ray to the radiance of the camera ray.
    throughput: mi.Spectrum
    #: Number of the node. A ray tree is numbered as a heap: the camera ray is node 1; the reflected ray of node n is
    #: node 2 n, and its refracted ray is node 2 n + 1.
    node: mi.UInt32
    #: Number of reflections and refractions before this ray; 0 for the camera ray.
    level: mi.UInt32
    #: Density per solid angle with which a lobe sampled ``d``; 0 for the camera ray and rays of ideal lobes, whose
    #: directions light sampling cannot sample.
    pdf: mi.Float
    #: Normal of the surface that the ray leaves, on the viewer's side.
    n: mi.Normal3f
    #: The medium around the ray (a ``mi.Medium`` or None in scalar variants); None where no medium of the scene absorbs
    #: light.
    medium: mi.MediumPtr | None
    #: The distance of ``o`` from the surface that the ray leaves.
    offset: mi.Float
    #: Whether emission at the end of the ray does not count, because light sampling at the ray's origin found the light
    #: of all lobes. With photons, also whether an earlier surface of the path gathered photons by the lobe through
    #: which the path left that surface: these photons found the light behind specular surfaces.
    light_found: mi.Bool
    #: Whether the ray continues the camera ray: all surfaces on the way let it pass straight through, like the hole
    #: of a ``mask``. None where this does not matter, or where no surface lets rays pass.
    passed: mi.Bool | None = None
    #: Whether light sampling at the ray's origin took light from both sides of the surface; None where no surface is
    #: lit from both sides.
    both_sides: mi.Bool | None = None
    #: The total importance of all lamps at the ray's origin; None where light sampling does not choose one lamp.
    importance: mi.Float | None = None
    #: The étendue (:mod:`..photons.mis`) at the last glossy surface, if the ray has met only ideal lobes since,
    #: else 0. It is unused after a diffuse lobe. None without photons on glossy surfaces.
    etendue: mi.Float | None = None

    @property
    def is_visible(self) -> mi.Bool:
        """Whether the camera sees the end of the ray, directly or through holes of surfaces."""
        return self.level == 0 if self.passed is None else self.passed


@dataclass
class Surface:
    """A point of a surface, and the BSDF of the surface at this point."""

    si: mi.SurfaceInteraction3f
    bsdf: mi.BSDFPtr
    #: The lanes whose ray met a surface and whose level is at most the maximum level.
    active: mi.Bool
    #: The active lanes whose BSDF cannot evaluate its lobes separately.
    inseparable: mi.Bool


@dataclass
class Vertex(Surface):
    """The surface point that a ray meets, with the data that light sampling and the sampling of the next rays need."""

    #: The active lanes whose BSDF has smooth lobes.
    smooth: mi.Bool
    #: The arriving ray, attenuated by absorption on its way.
    ray: Ray
    receiver: Receiver
    #: Type mask of a lobe -> its sample ``(bs, weight)``, where light sampling evaluated the lobe in the same call.
    drawn: dict[int, tuple[mi.BSDFSample3f, mi.Spectrum]] = field(default_factory=dict)


def mis(pdf: mi.Float, other: mi.Float) -> mi.Float:
    """Returns a sample's weight by the power heuristic (Veach 1997), for its density ``pdf``: 0 where this is 0, and 1
    where its square is infinite, as that of a lamp in the plane of the surface may be.
    """
    pdf, other = dr.square(pdf), dr.square(other)
    usual = (pdf > 0) & (pdf < dr.inf)
    return dr.select(usual, pdf / dr.select(usual, pdf + other, 1), dr.select(pdf > 0, 1, 0))


def viewer_side(si: mi.SurfaceInteraction3f) -> mi.Normal3f:
    """Returns the shading normal at ``si``, turned towards the origin of the ray that arrives at ``si``."""
    return si.sh_frame.n * dr.sign(mi.Frame3f.cos_theta(si.wi))
