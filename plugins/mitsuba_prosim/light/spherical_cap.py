"""Sampling of the part of a spherical light source above a surface's horizon, nearly by projected solid angle.

By Nusselt's analogy, directions with the density cos(theta) / (projected solid angle) project to points that are
uniform in area, in a region of the tangent plane: the projection of the cap that the light source covers on the unit
sphere of directions, above the horizon. :mod:`.strategy` gives the reason for this density.

The region is composed of two pieces, each sampled without rejection: the ellipse whose border is the projection of the
cap's boundary circle, if the centre is above the horizon; and the crescent between the ellipse and the unit circle,
where the horizon cuts the cap. The ellipse lies inside the unit circle, and touches it at the two ends of the crescent.
The region of a sphere whose centre is below the horizon, at height -c, is only the crescent; it is equal to that of a
sphere with its centre at height c, because mirrored caps have equal projections.

The ellipse is sampled uniformly; the crescent with a triangular density of the ordinate, which approximates its width
there. The variance due to this is at most 0.05 of the squared mean for spheres whose radius subtends up to 37 degrees.
An estimate of the crescent's area suffices to compute the exact density of the samples.

Lengths in the plane are divided by s, the sine of the angle that the sphere's radius subtends, so that the results for
tiny light sources are precise in single precision. No step subtracts nearly equal numbers, unless the sphere is almost
completely below the horizon.

All functions take Dr.Jit arrays, or Python floats in scalar variants. For a receiver inside or on the sphere
(``sin2_theta_max >= 1``), all densities are 0.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def pdf_projected_cap(cos_n: mi.Float, sin2_theta_max: mi.Float, y: mi.Float, z: mi.Float) -> mi.Float:
    """Returns the density per solid angle with which `sample_projected_cap` samples a direction that meets the sphere,
    with the coordinates ``y`` and ``z`` in the local frame; 0 below the horizon.
    """
    region = _Region(cos_n, sin2_theta_max)
    eta = dr.minimum(dr.abs(y) / dr.maximum(region.s * region.t, _TINY), 1)
    circle_x2 = 1 - dr.square(y)
    # The distance of the point (x, y) from the unit circle, along x. z² is circle_x2 minus x².
    to_circle = dr.square(z) / (dr.safe_sqrt(circle_x2) + dr.safe_sqrt(circle_x2 - dr.square(z)))
    in_ellipse = to_circle > dr.square(region.s) * region.width(eta)
    return dr.maximum(z, 0) * region.pdf(in_ellipse, eta)


def sample_projected_cap(
    cos_n: mi.Float, sin_n: mi.Float, sin2_theta_max: mi.Float, sample2: mi.Point2f
) -> tuple[mi.Vector3f, mi.Float]:
    """Samples a direction towards a sphere, above the horizon, and returns ``(local direction, pdf)``, both detached.

    The local frame has the z axis along the surface normal, and the sphere's centre in the half x >= 0 of the xz plane.
    ``cos_n`` and ``sin_n`` are the cosine and the sine of the angle between the normal and the direction to the centre:
    if this angle is small, the cosine alone does not define it precisely. ``sin2_theta_max`` is (radius / distance)².
    The density is per solid angle; it is 0 if the sphere is below the horizon, or if ``sin2_theta_max`` is 1 or more.
    The map from the unit square to directions is continuous within the ellipse and within the crescent
    (:class:`_Region`), so that stratified samples stay stratified.
    """
    cos_n, sin_n, sin2_theta_max, sample2 = dr.detach((cos_n, sin_n, sin2_theta_max, sample2))
    region = _Region(cos_n, sin2_theta_max)
    p = region.ellipse / dr.maximum(region.ellipse + region.crescent, _TINY)
    in_ellipse = sample2.x < p  # the probability of the ellipse
    u = dr.select(in_ellipse, sample2.x / dr.maximum(p, _TINY), (sample2.x - p) / dr.maximum(1 - p, _TINY))
    u_y = 2 * u - 1  # in the crescent: eta has the density 2 (1 - eta), and the sign of u_y is that of y
    eta = 1 - dr.sqrt(1 - dr.abs(u_y))
    whole = _direction_in_ellipse(cos_n, sin_n, sin2_theta_max, mi.Point2f(u, sample2.y))
    d = dr.select(in_ellipse, whole, region.direction_in_crescent(dr.mulsign(eta, u_y), sample2.y))
    return d, d.z * region.pdf(in_ellipse, eta)


_TINY = 1e-35


def _direction_in_ellipse(cos_n: mi.Float, sin_n: mi.Float, sin2_theta_max: mi.Float, u: mi.Point2f) -> mi.Vector3f:
    """Returns the local direction to the point, uniform in the ellipse, that ``u`` in [0, 1)² selects."""
    # Seen from above, the point's height is the height of the cap's boundary circle plus the bulge inside the circle.
    s, cos_max = dr.sqrt(sin2_theta_max), dr.safe_sqrt(1 - sin2_theta_max)
    p = mi.warp.square_to_uniform_disk_concentric(u)
    height = cos_max * cos_n + s * sin_n * p.x
    bulge = sin2_theta_max * dr.maximum(1 - dr.squared_norm(p), 0)
    return mi.Vector3f(cos_max * sin_n - s * cos_n * p.x, s * p.y, dr.sqrt(dr.square(height) + bulge))


class _Region:
    """The ellipse, and the crescent between the ellipse and the unit circle.

    The ellipse touches the unit circle at the two ends of the crescent, whose y coordinates are -s t and s t. ``m`` =
    |cos_n| / s is 0 for a sphere whose centre is on the horizon, and 1 for a sphere that touches the horizon. ``x_t``
    is the x coordinate of the two points where the ellipse touches the circle. ``s`` is the sine of the angle that the
    sphere's radius subtends, and s t is the y coordinate of the upper end of the crescent. ``eta`` in [0, 1] is the
    scaled ordinate |y| / (s t) of a point. ``ellipse`` is the area of the ellipse divided by s², or 0 if the centre is
    below the horizon; ``crescent`` estimates the area of the crescent divided by s².
    """

    def __init__(self, cos_n: mi.Float, sin2_theta_max: mi.Float) -> None:
        """Both areas are 0 if ``sin2_theta_max`` is 1 or more."""
        s2 = dr.minimum(sin2_theta_max, 1)
        self.s = dr.maximum(dr.sqrt(s2), _TINY)
        self.m = dr.minimum(dr.abs(cos_n) / self.s, 1)
        self.sin2_n = dr.maximum(1 - dr.square(cos_n), 1e-7)
        self.x_t = dr.minimum(dr.safe_sqrt((1 - s2) / self.sin2_n), 1)
        self.t2 = dr.minimum((1 - self.m) * (1 + self.m) / self.sin2_n, 1)
        self.t = dr.sqrt(self.t2)
        #: The width of the crescent at y = 0, divided by s².
        self.middle = self.t2 * (1 - self.m) / ((1 + self.x_t) * (1 + self.m * self.x_t))
        # The mean width divided by the width in the middle. For a small sphere with m = 0, the width is nearly a
        # parabola in eta, and the ratio is 2/3. For m near 1, it is nearly a squared parabola, and the ratio is 8/15.
        self.mean = (10 - 2 * self.m) / 15
        outside = sin2_theta_max < 1
        self.ellipse = dr.select(outside, dr.pi * dr.maximum(cos_n, 0), 0)
        self.crescent = dr.select(outside, 2 * self.s * self.t * self.mean * self.middle, 0)

    def circle(self, eta: mi.Float) -> mi.Float:
        """Returns the x coordinate of the point of the unit circle with the scaled ordinate ``eta``."""
        return dr.safe_sqrt(1 - dr.square(self.s * self.t * eta))

    def relative_width(self, eta: mi.Float) -> mi.Float:
        """Returns the crescent's width at the scaled ordinate ``eta``, divided by s² and by the parabola 1 - eta².

        The width of the crescent is the width of the circle beyond the chord x = x_t minus the width of the ellipse
        beyond this chord. With a common denominator, the numerator of the difference of the two widths is proportional
        to (y_t² - y²)², where y_t is the y coordinate of the crescent's upper end, and no term of the denominator is
        negative.
        """
        circle, ellipse = self.circle(eta), dr.safe_sqrt(1 - dr.square(self.t * eta))
        product = (circle + self.x_t) * (ellipse + self.m * self.x_t) * (ellipse + self.m * circle)
        return self.sin2_n * dr.square(self.t2) * (1 - dr.square(eta)) / dr.maximum(product, 1e-20)

    def width(self, eta: mi.Float) -> mi.Float:
        """Returns the crescent's width at the scaled ordinate ``eta``, divided by s²."""
        return (1 - dr.square(eta)) * self.relative_width(eta)

    def direction_in_crescent(self, eta: mi.Float, v: mi.Float) -> mi.Vector3f:
        """Returns the direction to the point of the crescent at the signed scaled ordinate ``eta``; ``v`` in [0, 1) is
        the relative position between the ellipse (0) and the unit circle (1).
        """
        circle = self.circle(eta)
        # The distance of the point from the unit circle, along x.
        to_circle = (1 - v) * self.width(eta) * dr.square(self.s)
        x = circle - to_circle
        return mi.Vector3f(x, self.s * self.t * eta, dr.safe_sqrt(to_circle * (x + circle)))

    def pdf(self, in_ellipse: mi.Bool, eta: mi.Float) -> mi.Float:
        """Returns the density, per area of the plane, of a sample in the ellipse (``in_ellipse``) or, at ``eta``, in
        the crescent; 0 if both areas are 0.
        """
        area = dr.square(self.s) * (self.ellipse + self.crescent)
        # In the crescent, the density of eta is proportional to 1 - eta. The width at eta has the same factor, which
        # cancels: (1 - eta²) / (1 - eta) = 1 + eta.
        width = dr.maximum((1 + eta) * self.relative_width(eta), 1e-6 * self.middle + _TINY)
        density = dr.select(in_ellipse, 1, 2 * self.mean * self.middle / width)
        return dr.select(area > 0, density / dr.maximum(area, _TINY), 0)
