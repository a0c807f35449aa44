"""What a material does, as curves: the figures of chapters 2 and 3 are drawn with these, from the plugins themselves.

Angles are in degrees from the normal. Below the surface is beyond 90, and the mirror direction of an incidence of
+30 is +30: both are measured in the plane of incidence, each to its own side of the normal.

Numbers are made opaque, so that all angles and widths share the kernels of a material.
"""

import drjit as dr
import mitsuba as mi


def direction(angles, side=1):
    """Unit vectors in the plane of incidence, on the positive (``side`` 1) or negative side of the normal."""
    angles = mi.Float(angles)
    dr.make_opaque(angles)
    sin, cos = dr.sincos(angles * (dr.pi / 180))
    return mi.Vector3f(side * sin, 0, cos)


def interaction(wi):
    """A point on a surface seen from ``wi`` (local)."""
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(wi))
    si.wi = wi
    if mi.is_spectral:
        si.wavelengths = mi.Spectrum(450, 510, 570, 630)
    return si


def reflectance(bsdf, angles):
    """Spectrum reflected by an ideally smooth surface, by angle of incidence (figures 2.4, 2.5, 2.6)."""
    context = mi.BSDFContext()
    context.component = 0
    si = interaction(direction(angles))
    return mi.unpolarized_spectrum(bsdf.sample(context, si, mi.Float(0), mi.Point2f(0.5))[1])


def radiance(bsdf, incidence, angles):
    """Spectrum that a surface sends to ``angles`` per unit of irradiance: the BRDF itself (figures 3.6, 3.7)."""
    wi, wo = direction(incidence), direction(angles, -1)
    value = bsdf.eval(mi.BSDFContext(), interaction(wi), wo)
    return mi.unpolarized_spectrum(value) / wo.z


def facets(alpha, n=256):
    """A grid of n² facets m with the solid angle of each: fine where a distribution of width ``alpha`` is high.

    Midpoints of a grid in the azimuth and in x, where 1 - cos is distributed as exp(-2 (1 - cos) / alpha²).
    """
    i = dr.arange(mi.UInt32, n * n)
    x, phi = (mi.Float(i % n) + 0.5) / n, (mi.Float(i // n) + 0.5) * (2 * dr.pi / n)
    width = dr.opaque(mi.Float, 0.5 * alpha * alpha)
    full = 1 - dr.exp(-1 / width)
    c = -width * dr.log(1 - x * full)
    sin = dr.sqrt(c * (2 - c))
    area = width * full / (1 - x * full) * (2 * dr.pi / (n * n))
    return mi.Normal3f(sin * dr.cos(phi), sin * dr.sin(phi), 1 - c), area


def albedo(bsdf, incidence, alpha, eta=None, n=256):
    """Share of the light from ``incidence`` that a rough specular surface sends back, and on (scalars).

    By quadrature over its facets, for a lobe of width about ``alpha``. ``eta``: interior over exterior index of a
    dielectric; None: nothing is transmitted. Energy is counted, not radiance.
    """
    m, area = facets(alpha, n)
    si = interaction(direction(incidence))
    context = mi.BSDFContext(mi.TransportMode.Importance)
    i_m = dr.dot(si.wi, m)

    def total(wo, jacobian, side):
        lit = (i_m * si.wi.z > 0) & (wo.z * si.wi.z * side > 0)
        value = dr.mean(mi.unpolarized_spectrum(bsdf.eval(context, si, wo, lit)))
        return dr.sum(dr.select(lit, value * jacobian * area, 0))

    back = total(mi.reflect(si.wi, m), 4 * dr.abs(i_m), 1)
    if eta is None:
        return back, mi.Float(0)
    f, cos_t, eta_it, eta_ti = mi.fresnel(i_m, mi.Float(eta))
    wo = mi.refract(si.wi, m, cos_t, eta_ti)
    o_m = dr.dot(wo, m)
    on = total(wo, dr.select(f < 1, dr.square(i_m / eta_it + o_m) / dr.abs(o_m), 0), -1)
    return back, on
