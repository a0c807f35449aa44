"""A ray of the tree or path, and the surface that it meets."""

from __future__ import annotations

from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi

from ..light.strategy import Receiver
from ..masks import but_not


@dataclass
class Ray:
    """A ray of the tree or path, with the data of its node. All fields are Dr.Jit arrays of one width, or None where
    they would stay as they are: Dr.Jit traces a loop twice in which a variable does.
    """

    o: mi.Point3f
    d: mi.Vector3f
    #: ``mi.Spectrum``: factor from the radiance of this ray to that of the camera ray.
    throughput: mi.Spectrum
    #: Number of the node. In a tree as in a heap: 1 is the camera's, 2 n and 2 n + 1 the reflected and refracted one
    #: of n.
    node: mi.UInt32
    #: Number of reflections and refractions before this ray: 0 is the camera's.
    level: mi.UInt32
    #: Density per solid angle with which a lobe sampled ``d``; undefined unless ``uses_mis``.
    pdf: mi.Float
    #: Whether light sampling at its origin could have found the emission that it meets, too: that gets an MIS weight.
    uses_mis: mi.Bool
    #: Normal of the surface that the ray leaves, on the viewer's side.
    n: mi.Normal3f
    #: Whether emission that it meets counts; not where light sampling at its origin took all lobes. None: always.
    sees_emission: mi.Bool | None = None
    #: Whether light from both sides of that surface was sampled; None where no surface has any.
    both_sides: mi.Bool | None = None
    #: Where a medium of the scene absorbs: the medium of the ray (``mi.Medium`` in scalar variants) ...
    medium: mi.MediumPtr | None = None
    #: ... and the distance of ``o`` from the surface that it leaves.
    offset: mi.Float | None = None
    #: Whether a surface before has gathered photons by the lobe that a ray left it by, so that light behind specular
    #: surfaces does not count; None where no ray leaves by such a lobe.
    gathered_photons: mi.Bool | None = None
    #: Where light sampling chooses among lamps: their total importance at the ray's origin.
    importance: mi.Float | None = None
    #: Where layers depend on it: the layer of all light that comes by the lobe that left the first vertex.
    branch: mi.UInt32 | None = None

    @classmethod
    def first(cls, camera: mi.Ray3f) -> Ray:
        """The camera's ray."""
        node, level, n = mi.UInt32(1), mi.UInt32(0), mi.Normal3f(camera.d)
        return cls(camera.o, camera.d, mi.Spectrum(1), node, level, mi.Float(0), mi.Bool(False), n)


@dataclass
class Surface:
    """A point of a surface, and the BSDF there."""

    si: mi.SurfaceInteraction3f
    bsdf: mi.BSDFPtr
    #: The lanes that met a surface; those of the eye's rays, at the deepest level at most.
    active: mi.Bool
    #: The active lanes whose BSDF cannot evaluate its lobes separately.
    inseparable: mi.Bool


@dataclass
class Vertex(Surface):
    """The surface point that a ray meets, for light sampling and for the rays that leave it."""

    #: Those of the active lanes that have smooth lobes.
    smooth: mi.Bool
    #: The ray as it arrives, attenuated by absorption on its way.
    ray: Ray
    receiver: Receiver
    #: Samples ``(bs, weight)`` of lobes by their type mask, where light sampling evaluated the lobe in the same call.
    drawn: dict[int, tuple[mi.BSDFSample3f, mi.Spectrum]] = field(default_factory=dict)

    def before_gathering(self, active: mi.Bool) -> mi.Bool:
        """The active lanes whose ray has left no surface that gathered photons by the same lobe."""
        return active if self.ray.gathered_photons is None else but_not(active, self.ray.gathered_photons)


def mis(pdf: mi.Float, other: mi.Float) -> mi.Float:
    """MIS weight of a sample of density ``pdf`` that ``other`` could have found too: power heuristic (Veach 1997)."""
    a, b = dr.square(pdf), dr.square(other)
    return dr.select(a > 0, a / dr.select(a > 0, a + b, 1), 0)


def viewer_side(si: mi.SurfaceInteraction3f) -> mi.Normal3f:
    """Shading normal, on the viewer's side."""
    return si.sh_frame.n * dr.sign(mi.Frame3f.cos_theta(si.wi))
