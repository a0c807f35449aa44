"""A ray of the tree or path, and what it has met."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi


@dataclass
class Ray:
    """A ray of the tree or path, with what its node needs. All fields are Dr.Jit arrays of one width, or None where
    they would stay as they are: Dr.Jit follows a loop twice in which something does.
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
    #: Density per solid angle with which a lobe drew ``d``; of no meaning unless ``shares``.
    pdf: mi.Float
    #: Whether a source that it meets could have been sampled at its origin too, and shares its light with that.
    shares: mi.Bool
    #: Normal of the surface that the ray leaves, on the viewer's side.
    n: mi.Normal3f
    #: Whether a source that it meets counts at all; not where the sources were sampled in full. None: all do.
    counts: mi.Bool | None = None
    #: Whether light from both of the sides of that surface was sampled; None where that is of none.
    both_sides: mi.Bool | None = None
    #: Where anything in the scene absorbs: what the ray goes through (``mi.Medium`` in scalar variants) ...
    medium: mi.MediumPtr | None = None
    #: ... and how far along it ``o`` is from the surface that it leaves.
    gap: mi.Float | None = None
    #: State of the MIS between photons and rays (:class:`.context.PhotonMIS`), where glossy surfaces gather photons.
    etendue: Any = None
    #: Whether the ray comes from a BSDF without separable lobes where photons were gathered, so that it must not count
    #: the light behind specular surfaces; None where there are no such photons.
    gathered: mi.Bool | None = None
    #: Where one of several lamps is sampled at the ray's origin: the sum of their estimates there, see
    #: :mod:`..light.light_sampler`.
    estimates: mi.Float | None = None

    @classmethod
    def first(cls, camera: mi.Ray3f) -> Ray:
        """The camera's ray."""
        return cls(
            camera.o,
            camera.d,
            mi.Spectrum(1),
            mi.UInt32(1),
            mi.UInt32(0),
            mi.Float(0),
            mi.Bool(False),
            mi.Normal3f(camera.d),
        )


@dataclass
class Vertex:
    """Where a ray ends, for the rays that leave from there."""

    #: The ray as it arrives, less what was absorbed on its way.
    ray: Ray
    si: mi.SurfaceInteraction3f
    bsdf: mi.BSDFPtr
    #: The lanes that met a surface.
    surface: mi.Bool
    #: Sum of the lamps' estimates; see :attr:`Ray.estimates`.
    estimates: mi.Float | None = None


def mis(pdf: mi.Float, other: mi.Float) -> mi.Float:
    """Weight of a sample of density ``pdf`` that ``other`` could have given too: power heuristic (Veach 1997)."""
    a, b = dr.square(pdf), dr.square(other)
    return dr.select(a > 0, a / dr.select(a > 0, a + b, 1), 0)


def viewer_side(si: mi.SurfaceInteraction3f) -> mi.Normal3f:
    """Shading normal, turned to the side that the surface is seen from."""
    return si.sh_frame.n * dr.sign(mi.Frame3f.cos_theta(si.wi))
