"""Curves of optical properties of materials, computed by the plugins, for the figures of chapters 2 and 3.

Angles are in degrees from the normal, in the plane of incidence; angles above 90 are below the surface. Angles of
incidence and of reflection are measured to opposite sides of the normal, so the mirror direction of the incidence +30
is +30.

Numbers are made opaque for Dr.Jit, so that one kernel of a material serves all angles and widths.
"""

import drjit as dr
import mitsuba as mi


def direction(angles, side=1):
    """Unit vectors in the plane of incidence, on the positive (``side`` 1) or negative (-1) side of the normal."""
    angles = mi.Float(angles)
    dr.make_opaque(angles)
    sin, cos = dr.sincos(angles * (dr.pi / 180))
    return mi.Vector3f(side * sin, 0, cos)


def interaction(wi):
    """A surface interaction whose local direction to the viewer is ``wi``."""
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(wi))
    si.wi = wi
    if mi.is_spectral:
        si.wavelengths = mi.Spectrum(450, 510, 570, 630)
    return si


def reflectance(bsdf, angles):
    """Reflectance spectrum of an ideally smooth surface for angles of incidence (figures 2.4, 2.5, 2.6)."""
    context = mi.BSDFContext()
    context.component = 0
    si = interaction(direction(angles))
    return mi.unpolarized_spectrum(bsdf.sample(context, si, mi.Float(0), mi.Point2f(0.5))[1])


def radiance(bsdf, incidence, angles):
    """Spectrum of the BRDF: reflected radiance in the directions ``angles`` per irradiance (figures 3.6, 3.7)."""
    wi, wo = direction(incidence), direction(angles, -1)
    value = bsdf.eval(mi.BSDFContext(), interaction(wi), wo)
    return mi.unpolarized_spectrum(value) / wo.z


def facets(alpha, n=256):
    """n² facet normals m and their solid angles; the grid is fine where a distribution of width ``alpha`` is large.

    The normals are the midpoints of a grid in the azimuth and in x. If x is uniform, 1 - cos is distributed
    exponentially, with the scale alpha² / 2, and truncated at 1.
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
    """Fractions of the light from ``incidence`` that a rough specular surface reflects and transmits (two scalars).

    The integral over the facets is computed by quadrature, for a lobe of width about ``alpha``. ``eta`` is the interior
    over the exterior index of a dielectric; None means that no light is transmitted. The fractions are of energy, not
    of radiance.
    """
    m, area = facets(alpha, n)
    si = interaction(direction(incidence))
    context = mi.BSDFContext(mi.TransportMode.Importance)
    i_m = dr.dot(si.wi, m)

    def total(wo, jacobian, side):
        """Integrates the BSDF over the facets; ``jacobian`` is the solid angle of ``wo`` per solid angle of the
        facet.
        """
        lit = (i_m * si.wi.z > 0) & (wo.z * si.wi.z * side > 0)
        value = dr.mean(mi.unpolarized_spectrum(bsdf.eval(context, si, wo, lit)))
        return dr.sum(dr.select(lit, value * jacobian * area, 0))

    reflected = total(mi.reflect(si.wi, m), 4 * dr.abs(i_m), 1)
    if eta is None:
        return reflected, mi.Float(0)
    f, cos_t, eta_it, eta_ti = mi.fresnel(i_m, mi.Float(eta))
    wo = mi.refract(si.wi, m, cos_t, eta_ti)
    o_m = dr.dot(wo, m)
    transmitted = total(wo, dr.select(f < 1, dr.square(i_m / eta_it + o_m) / dr.abs(o_m), 0), -1)
    return reflected, transmitted
