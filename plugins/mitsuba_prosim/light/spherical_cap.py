"""A sphere that lights a surface: its projected solid angle above the horizon, in closed form, and directions drawn
from it.

Directions with density cos(theta) / (projected solid angle) leave no variance in the direct light of a diffuse surface
that sees the whole of a uniform sphere (section 4.2.2.1 samples the solid angle; the projected one is due to Ureña and
Georgiev 2018, Peters and Dachsbacher 2019). By Nusselt's analogy such directions are the points of a plane region,
uniform in area: the projection of the visible part of the sphere's cap onto the surface's tangent plane.

That region is composed here of two pieces, each sampled without rejection:

- for a centre above the horizon, the ellipse that the whole cap projects to;
- where the horizon cuts the cap, the crescent between that ellipse and the unit circle, to which both are tangent.
  A centre at height -c leaves the crescent alone, the mirror image of the one for c.

Lengths in the plane are divided by s, the sine of the angle that the sphere's radius subtends, so that tiny sources
keep their precision in single precision arithmetic; no step subtracts nearly equal numbers, except for the sliver that
shows when the sphere has nearly set.

All functions take Dr.Jit arrays, or Python floats in scalar variants. A receiver inside the sphere, or on it
(``sin2_theta_max >= 1``), sees no cap: the area and the densities are then 0, by which a caller knows.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

NEWTON_STEPS = 2  # leaves the error of the distribution below 1e-5 for caps of up to 64 degrees, 1e-4 for any other


def projected_cap_area(cos_n: mi.Float, sin2_theta_max: mi.Float) -> mi.Float:
    """Projected solid angle in [0, pi] of the part of a sphere that is above the horizon.

    ``cos_n``: cosine between the normal and the direction to the centre; ``sin2_theta_max``: (radius / distance)².
    Times the radiance this is the irradiance, unoccluded; over pi, the form factor. For a sphere wholly above the
    horizon it is pi (r/d)² cos_n.
    """
    return dr.if_stmt(
        (cos_n, sin2_theta_max),
        _is_cut(cos_n, sin2_theta_max),
        lambda cos_n, sin2: _ellipse_area(cos_n, sin2) + _Crescent(cos_n, sin2).area,
        _ellipse_area,
        label="area",
    )


def pdf_projected_cap(cos_n: mi.Float, sin2_theta_max: mi.Float, cos_theta: mi.Float) -> mi.Float:
    """Density per solid angle with which `sample_projected_cap` draws a direction that meets the sphere.

    ``cos_theta`` is the cosine between that direction and the normal; below the horizon the density is 0.
    """
    area = projected_cap_area(cos_n, sin2_theta_max)
    return dr.select(area > 0, dr.maximum(cos_theta, 0) / dr.maximum(area, _TINY), 0)


def sample_projected_cap(
    cos_n: mi.Float, sin_n: mi.Float, sin2_theta_max: mi.Float, sample2: mi.Point2f
) -> tuple[mi.Vector3f, mi.Float]:
    """Draws a direction towards a sphere, cosine-weighted and above the horizon: ``(local direction, pdf)``.

    The frame has z along the normal and the sphere's centre in the half-plane x >= 0 of xz. The map from the unit
    square is continuous within each of the two pieces and keeps area ratios, so that stratified samples stay so.
    Parameters as in `projected_cap_area`; ``sin_n`` is the sine that belongs to ``cos_n`` (of a source overhead, the
    cosine alone does not tell where it is); the density is per solid angle. Both results are detached: derivatives go
    through the value in the direction, not through the choice of the direction.
    """
    cos_n, sin_n, sin2_theta_max, sample2 = dr.detach((cos_n, sin_n, sin2_theta_max, sample2))
    # Most receivers see the whole sphere; the branch spares them the crescent, which costs more than all the rest.
    d, area = dr.if_stmt(
        (cos_n, sin_n, sin2_theta_max, sample2),
        _is_cut(cos_n, sin2_theta_max),
        _sample_cut_cap,
        _sample_whole_cap,
        label="cap",
    )
    return d, dr.select(area > 0, d.z / dr.maximum(area, _TINY), 0)


_TINY = 1e-35


def _is_cut(cos_n: mi.Float, sin2_theta_max: mi.Float) -> mi.Bool:
    """Whether the horizon cuts the sphere."""
    return (dr.square(cos_n) < sin2_theta_max) & (sin2_theta_max < 1)


def _ellipse_area(cos_n: mi.Float, sin2_theta_max: mi.Float) -> mi.Float:
    """Area of the ellipse; that of the whole region where the horizon does not cut the sphere."""
    return dr.select(sin2_theta_max < 1, dr.pi * sin2_theta_max * dr.maximum(cos_n, 0), 0)


def _sample_whole_cap(
    cos_n: mi.Float, sin_n: mi.Float, sin2_theta_max: mi.Float, sample: mi.Point2f
) -> tuple[mi.Vector3f, mi.Float]:
    """Direction to a point of the ellipse, and the ellipse's area."""
    # In the projection from above: the point's height is that on the cap's boundary circle, plus the bulge within.
    s, cos_max = dr.sqrt(sin2_theta_max), dr.safe_sqrt(1 - sin2_theta_max)
    p = mi.warp.square_to_uniform_disk_concentric(sample)
    height = cos_max * cos_n + s * sin_n * p.x
    bulge = sin2_theta_max * dr.maximum(1 - dr.squared_norm(p), 0)
    d = mi.Vector3f(cos_max * sin_n - s * cos_n * p.x, s * p.y, dr.sqrt(dr.square(height) + bulge))
    return d, _ellipse_area(cos_n, sin2_theta_max)


def _sample_cut_cap(
    cos_n: mi.Float, sin_n: mi.Float, sin2_theta_max: mi.Float, sample: mi.Point2f
) -> tuple[mi.Vector3f, mi.Float]:
    """Direction to a point of the ellipse or the crescent, and the area of both."""
    crescent = _Crescent(cos_n, sin2_theta_max)
    ellipse = _ellipse_area(cos_n, sin2_theta_max)
    area = ellipse + crescent.area
    share = ellipse / dr.maximum(area, _TINY)
    in_ellipse = sample.x < share
    u = dr.select(in_ellipse, sample.x / dr.maximum(share, _TINY), (sample.x - share) / dr.maximum(1 - share, _TINY))
    whole, _ = _sample_whole_cap(cos_n, sin_n, sin2_theta_max, mi.Point2f(u, sample.y))
    return dr.select(in_ellipse, whole, mi.Vector3f(*crescent.sample(u, sample.y))), area


class _Crescent:
    """The region between the ellipse and the unit circle, |y| <= y_t, where (x_t, +-y_t) are the points of tangency.

    Lengths are in units of s; ``m`` = |cos_n| / s is 0 for a centre on the horizon, 1 for a sphere that touches it.
    """

    def __init__(self, cos_n: mi.Float, sin2_theta_max: mi.Float) -> None:
        s2 = dr.minimum(sin2_theta_max, 1)
        self.s = dr.maximum(dr.sqrt(s2), _TINY)
        self.m = dr.minimum(dr.abs(cos_n) / self.s, 1)
        self.sin2_n = dr.maximum(1 - dr.square(cos_n), 1e-7)
        self.x_t = dr.minimum(dr.safe_sqrt((1 - s2) / self.sin2_n), 1)
        self.t2 = dr.minimum((1 - self.m) * (1 + self.m) / self.sin2_n, 1)
        self.t = dr.sqrt(self.t2)
        self.half, _ = self.integrate(1)
        self.half = dr.select((self.m < 1) & (sin2_theta_max < 1), dr.maximum(self.half, 0), 0)
        self.area = 2 * s2 * self.s * self.half

    def integrate(self, eta: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Area (over s³) from the axis of symmetry to the ordinate y = eta y_t, and the crescent's width (over s²)
        there.

        The width is that of the circle beyond the chord x_t less that of the ellipse beyond it. Their difference,
        brought to a common denominator, has (y_t² - y²)² as its numerator and nothing negative below.
        """
        t = self.t * eta
        rest = self.t2 * (1 - dr.square(eta))
        circle, ellipse = self.circle(t), dr.safe_sqrt(1 - dr.square(t))
        width = (
            self.sin2_n
            * rest
            / dr.maximum(circle + self.x_t, 1e-12)
            * (rest / dr.maximum((ellipse + self.m * self.x_t) * (ellipse + self.m * circle), 1e-12))
        )
        segments = _segment(self.s * t, circle) - self.m * _segment(t, ellipse)
        return 0.5 * t * dr.square(t) * segments + t * width, width

    def circle(self, t: mi.Float) -> mi.Float:
        """Abscissa of the unit circle at the ordinate s t."""
        return dr.safe_sqrt(1 - dr.square(self.s * t))

    def sample(self, u: mi.Float, v: mi.Float) -> tuple[mi.Float, mi.Float, mi.Float]:
        """Point (x, y) uniform in area, and the height z of the unit hemisphere above it.

        Inverts the area up to y by Newton's method on the 2.5th root of the area beyond y: it vanishes at the tip with
        a power between 2 (m = 0, whose inverse is the first guess) and 3.
        """
        u = 2 * u - 1
        beyond = 1 - dr.abs(u)
        eta = 2 * dr.sin(dr.asin(dr.abs(u)) / 3)
        half = dr.maximum(self.half, _TINY)
        for _ in range(NEWTON_STEPS):
            area, width = self.integrate(eta)
            tail = dr.maximum(1 - area / half, 1e-7)
            step = 2.5 * tail * (1 - (beyond / tail) ** 0.4) * half / dr.maximum(width * self.t, _TINY)
            eta = dr.clip(eta + step, 0, 1)
        t = self.t * eta
        _, width = self.integrate(eta)
        left = (1 - v) * width * dr.square(self.s)  # distance to the circle, along x
        x = self.circle(t) - left
        return x, dr.mulsign(self.s * t, u), dr.safe_sqrt(left * (x + self.circle(t)))


def _segment(sin_a: mi.Float, cos_a: mi.Float) -> mi.Float:
    """(a - sin a cos a) / sin³ a for an angle a in [0, pi/2]: a segment's area over the cube of half its chord."""
    x = dr.square(sin_a)
    # 2/3 sin³ a (1 + ...): the integral of 2 y² / sqrt(1 - y²), term by term.
    series = 2 / 3 + x * (1 / 5 + x * (3 / 28 + x * (5 / 72 + x * (35 / 704 + x * (63 / 1664)))))
    exact = (dr.atan2(sin_a, cos_a) - sin_a * cos_a) / dr.maximum(sin_a * x, _TINY)
    return dr.select(sin_a < 0.3, series, exact)
