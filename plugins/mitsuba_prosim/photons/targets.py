"""Targets at which photons are aimed: bounding spheres around all specular surfaces of the scene."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

from ..compat import INSTANCE, SPHERE, mesh_positions
from ..light.beam import sample_falloff
from ..masks import fold
from ..transport import lobes
from ..transport.workarounds import is_inseparable

#: Maximum number of spheres. If there are more specular surfaces, neighbours share one sphere.
MAX_TARGETS = 64

#: Ratio of a sphere's radius to the radius of its contents, so that rounding loses nothing.
MARGIN = 1 + 1e-4


class Targets:
    """Bounding spheres around the specular ``shapes``, of which there is at least one; photons are aimed at them."""

    def __init__(self, shapes: Sequence[mi.Shape]) -> None:
        spheres = merged([bounding_sphere(shape) for shape in shapes])
        # The arrays are made of lists: Dr.Jit would share the memory of a NumPy array, and kernels differ by its
        # alignment.
        x, y, z, radii = np.array(spheres, dtype=np.float32).T.tolist()
        #: Number of the spheres, and their centers and radii, with one entry per sphere.
        self.count, self.centers, self.radii = len(spheres), mi.Point3f(x, y, z), mi.Float(radii)
        dr.make_opaque(self.centers, self.radii)

    def at(self, k: mi.UInt32) -> tuple[mi.Point3f, mi.Float]:
        """Returns the center and the radius of the sphere number ``k``."""
        return dr.gather(mi.Point3f, self.centers, k), dr.gather(mi.Float, self.radii, k)

    def density(
        self, x: mi.Point3f, d: mi.Vector3f, far: bool, active: mi.Bool, own: mi.UInt32 | None = None
    ) -> mi.Float:
        """Returns the density of photons along the ray from ``x`` in the direction ``d``, if one photon is aimed at
        each sphere: per solid angle or, if ``far``, per area at right angles to parallel rays.

        ``own`` is the number of the sphere at which the ray was aimed, which it meets despite rounding errors.
        """

        def add(k: mi.UInt32, total: mi.Float) -> mi.Float:
            center, radius = self.at(k)
            to_center, r2 = center - x, dr.square(radius)
            met = dr.squared_norm(dr.cross(to_center, d)) <= r2
            if not far:
                met = (met & (dr.dot(to_center, d) > 0)) | (dr.squared_norm(to_center) <= r2)
            if own is not None:
                met |= k == own
            # The area of the disk, or the solid angle of the sphere, over which one photon is spread.
            size = dr.pi * r2 if far else dr.two_pi * versine(x, center, radius)
            return total + dr.select(met, dr.rcp(size), 0)

        return fold(self.count, add, mi.Float(0), active, unrolled=False)


def is_specular(shape: mi.Shape, tree: bool) -> bool:
    """Tells whether ``shape`` may scatter photons by a specular lobe; on paths, without ``tree``, inseparable BSDFs
    scatter them only by ideal or null lobes.
    """
    if shape.class_name() == INSTANCE:
        return True  # an instance does not expose its BSDFs
    bsdf = shape.bsdf()
    if bsdf is None:
        return False
    names = lobes.IDEAL if is_inseparable(bsdf) and not tree else lobes.SPECULAR
    return bool(lobes.has_any(int(bsdf.flags()), *names))


def warn_of_light_missed_by_trees(shapes: Sequence[mi.Shape]) -> None:
    """Warns if at least two of the ``shapes`` have inseparable BSDFs, and one of these has a glossy transmission."""
    inseparable = [shape for shape in shapes if shape.bsdf() is not None and is_inseparable(shape.bsdf())]
    through = [s for s in inseparable if lobes.has_any(int(s.bsdf().flags()), "GlossyTransmission")]
    if through and len(inseparable) > 1:
        onto = ", ".join(repr(s.id()) for s in inseparable if s is not through[0])
        mi.Log(
            mi.LogLevel.Warn,
            f"prosim: in a ray tree, caustics omit the light that {through[0].id()!r} casts on {onto}: their materials "
            "have inseparable lobes. Paths (diffuse_bounces) find this light. In a ray tree, use prosim_dielectric or "
            "roughdielectric for the glass, or prosim_composite, roughplastic or diffuse for the other materials.",
        )


def bounding_sphere(shape: mi.Shape) -> tuple[float, float, float, float]:
    """Returns ``(x, y, z, radius)`` of a sphere around ``shape``, with the factor :data:`MARGIN`."""
    box = shape.bbox()
    center = np.array(box.center(), dtype=np.float64)
    if (vertices := mesh_positions(shape)) is not None:
        radius = float(np.sqrt(np.max(np.sum((vertices - center) ** 2, axis=1))))
    elif shape.class_name() == SPHERE:
        radius = float(box.extents()[0]) / 2
    else:
        radius = float(box.bounding_sphere().radius)
    return (*center.tolist(), MARGIN * radius)


def merged(spheres: ArrayLike, max_count: int = MAX_TARGETS) -> list[tuple[float, ...]]:
    """Returns at most ``max_count`` spheres that together contain all the given ``spheres``, which are split into two
    halves along the axis of their greatest extent, and so on.
    """
    group = np.array(spheres, dtype=np.float64)
    if min(max_count, len(group)) == 1:
        return [sphere_around(group)]
    group = group[np.argsort(group[:, np.argmax(np.ptp(group[:, :3], axis=0))], kind="stable")]
    half, half_count = len(group) // 2, max_count // 2
    return merged(group[:half], half_count) + merged(group[half:], max_count - half_count)


def sphere_around(spheres: np.ndarray) -> tuple[float, ...]:
    """Returns one sphere, (x, y, z, radius), around all ``spheres``, an array of shape (n, 4)."""
    low, high = (spheres[:, :3] - spheres[:, 3:]).min(axis=0), (spheres[:, :3] + spheres[:, 3:]).max(axis=0)
    center = (low + high) / 2 if len(spheres) > 1 else spheres[0, :3]
    radius = float(np.max(np.linalg.norm(spheres[:, :3] - center, axis=1) + spheres[:, 3]))
    return (*center.tolist(), radius)


# ---------------------------------------------------------------- from a point


def versine(x: mi.Point3f, center: mi.Point3f, radius: mi.Float) -> mi.Float:
    """Returns 1 - cos of half the angle of a sphere, seen from ``x``; 2, all directions, from inside."""
    sin2 = dr.square(radius) / dr.maximum(dr.squared_norm(center - x), 1e-30)
    return dr.select(sin2 < 1, sin2 / (1 + dr.safe_sqrt(1 - sin2)), 2)


def direction(x: mi.Point3f, center: mi.Point3f, radius: mi.Float, sample: mi.Point2f) -> mi.Vector3f:
    """Samples a direction from ``x`` to a sphere, uniform over its solid angle; any direction from inside."""
    axis = dr.select(dr.squared_norm(center - x) > 1e-30, dr.normalize(center - x), mi.Vector3f(0, 0, 1))
    return mi.Frame3f(axis).to_world(sample_falloff(sample, versine(x, center, radius)))
