"""How a direction towards a source moves when the source does, or what it lights: for derivatives.

A direction that a light or a lobe drew is fixed while an image is made. Were it fixed in its derivatives too, what
enters and leaves at the edge of a moving source would be lost. It is therefore carried along: it stays with a point of
the source, and what it stands for in solid angle is stretched in proportion to the Jacobian of that map. Any map will
do that keeps to the source and whose Jacobian is known; all samples of a source have the same one, whichever density
they were drawn with, so that their weights in multiple importance sampling may be differentiated along it.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def with_ball(
    o: mi.Point3f, n: mi.Normal3f, center: mi.Point3f, radius: mi.Float, d: mi.Vector3f
) -> tuple[mi.Vector3f, mi.Float]:
    """Carries the direction ``d`` from ``o`` along with a sphere that it meets: ``(d, jacobian)``, with derivatives.

    The direction is that of a point of the disk that the sphere's outline encloses as it is seen from ``o``, lifted to
    the unit sphere: along the normal ``n`` where the whole sphere is above the horizon, so that no light is gained or
    lost on a diffuse surface between the parts of the sphere (the map of :mod:`.spherical_cap`), else along its axis. A
    point of the sphere itself would serve as well, but for its outline, where the Jacobian varies without bound.
    """
    to_center = center - o
    inv_d2 = dr.rcp(dr.squared_norm(to_center))
    axis = to_center * dr.sqrt(inv_d2)
    s2 = dr.minimum(dr.square(radius) * inv_d2, 1 - 1e-6)
    s, cos_max = dr.sqrt(s2), dr.sqrt(1 - s2)
    cos_n = dr.dot(axis, n)
    lift = dr.select((cos_n > 0) & (dr.square(cos_n) > s2), mi.Vector3f(n), axis)
    with dr.suspend_grad():
        height = (dr.dot(axis, d) - cos_max) / dr.dot(axis, lift)
        in_disk = (d - height * lift - cos_max * axis) / s
    in_disk -= axis * dr.dot(axis, in_disk)
    foot = cos_max * axis + s * in_disk
    b = dr.dot(foot, lift)
    height = dr.sqrt(dr.square(b) + s2 * dr.maximum(1 - dr.squared_norm(in_disk), 0)) - b
    moved = dr.replace_grad(d, foot + height * lift)
    return moved, s2 * dr.dot(axis, lift) / dr.dot(moved, lift)


def with_surface(o: mi.Point3f, met: mi.SurfaceInteraction3f) -> tuple[mi.Vector3f, mi.Float]:
    """Carries the direction from ``o`` to the point ``met`` along with the surface on which it is:
    ``(d, jacobian)``, with derivatives.

    ``met`` is a ``mi.SurfaceInteraction3f`` that was made with ``mi.RayFlags.FollowShape``.
    """
    to_point = met.p - o
    d2 = dr.squared_norm(to_point)
    d = to_point * dr.rsqrt(d2)
    return d, dr.abs_dot(met.n, d) / d2 * dr.norm(dr.cross(met.dp_du, met.dp_dv))
