"""What a ray sees that leaves the scene."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def background_radiance(
    background: mi.Texture, ray: mi.Ray3f, si: mi.SurfaceInteraction3f, active: mi.Bool
) -> mi.UnpolarizedSpectrum:
    """Radiance of the texture ``background`` in the direction of ``ray``; ``si``: what the ray has met, i.e. nothing.

    An image is looked up by latitude and longitude as Mitsuba's ``envmap`` has them: y is up, u = 0 towards +z.
    """
    d = ray.d
    si = mi.SurfaceInteraction3f(si)  # whoever called still needs its own uv
    u = dr.atan2(d.x, -d.z) * dr.inv_two_pi
    si.uv = mi.Point2f(u - dr.floor(u), dr.safe_acos(d.y) * dr.inv_pi)
    return background.eval(si, active)
