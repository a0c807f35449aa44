"""Directions are drawn with the density that ``pdf`` states: Pearson's chi² tests, at 1 % for the whole file.

A lobe of roughness 0.02 is too narrow for a histogram over the sphere, so those of facets are binned by the facet's
normal: its azimuth, and x in [0, 1] from its polar angle, about uniform for a lobe of the given width. What is
transmitted lies in 1 <= x <= 2. This tests the solid angles of reflection and refraction as well.
"""

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from drawing.curves import interaction
from mitsuba.chi2 import ChiSquareTest, PlanarDomain, SphericalDomain
from scenes import only

ALPHAS = (0.02, 0.2, 1.0)
INCIDENCES = (0, 30, 60, 85)
INSIDE = (180, 150, 120, 95)
TESTS = 200
IOR = 1.5046 / 1.000277


def roughness(distribution, alpha):
    return {"exponent": 2 / alpha**2 - 2} if distribution == "phong" else {"distribution": distribution, "alpha": alpha}


def incident(angle):
    """A direction that kernels do not know when they are compiled, so that all angles share them."""
    t = math.radians(angle)
    wi = mi.Vector3f(0.8 * math.sin(t), 0.6 * math.sin(t), math.cos(t))
    dr.make_opaque(wi)
    return wi


def draw(bsdf, ctx, wi, u):
    """Directions drawn, the interaction, and whether they are valid."""
    si = interaction(wi + dr.zeros(mi.Vector3f, dr.width(u)))
    bs, weight = bsdf.sample(ctx, si, u[0], mi.Point2f(u[1], u[2]))
    assert not dr.any(dr.isnan(bs.pdf) | dr.any(dr.isnan(weight)))
    return bs.wo, si, (bs.pdf > 0) & dr.any(weight > 0)


def assert_accepted(test):
    assert test.run(0.01, TESTS, quiet=True), f"p = {test.p_value}\n{test.messages}"


def check_facets(bsdf, angle, alpha, ctx=None, eta=IOR):
    """Chi² of a lobe of facets, by reflection alone or by reflection and refraction."""
    ctx = ctx or mi.BSDFContext()
    wi = incident(angle)
    # index beyond over that on wi's side; width of the lobe, and how much of it lies above the horizon
    sizes = (eta if angle < 90 else 1 / eta, 0.5 * alpha * alpha, 1 - math.exp(-2 / (alpha * alpha)))
    side, width, full = (dr.opaque(mi.Float, size) for size in sizes)
    two = bsdf.component_count() == 2 and mi.has_flag(bsdf.flags(), mi.BSDFFlags.Transmission)

    def sample(u):
        wo, si, valid = draw(bsdf, ctx, wi, u)
        reflected = wo.z * si.wi.z > 0
        m = dr.normalize(si.wi + wo * dr.select(reflected, 1, side))
        m = dr.mulsign(m, m.z)
        x = (1 - dr.exp(-(m.x**2 + m.y**2) / (1 + m.z) / width)) / full
        p = mi.Point2f(x + dr.select(reflected, 0, 1), dr.atan2(m.y, m.x))
        return dr.select(valid, p, 0), dr.select(valid, 1.0, 0.0)

    def pdf(p):
        reflected = p.x < 1
        rest = 1 - (p.x - dr.select(reflected, 0, 1)) * full
        c = -width * dr.log(rest)  # 1 - cos
        sin = dr.sqrt(c * (2 - c))
        m = mi.Normal3f(sin * dr.cos(p.y), sin * dr.sin(p.y), 1 - c)
        si = interaction(wi + dr.zeros(mi.Vector3f, dr.width(p)))
        i_m = dr.dot(si.wi, m)
        f, cos_t, _, inverse = mi.fresnel(i_m, mi.Float(eta))
        wo = dr.select(reflected, mi.reflect(si.wi, m), mi.refract(si.wi, m, cos_t, inverse))
        o_m = dr.dot(wo, m)
        angles = dr.select(reflected, 4 * dr.abs(o_m), dr.square(i_m * inverse + o_m) / dr.abs(o_m))
        valid = (i_m * si.wi.z > 0) & (reflected | (f < 1)) & ((wo.z * si.wi.z > 0) == reflected)
        return dr.select(valid, bsdf.pdf(ctx, si, wo) * angles * width * full / rest, 0)

    domain = PlanarDomain(mi.ScalarBoundingBox2f([0, -math.pi], [2 if two else 1, math.pi]))
    assert_accepted(ChiSquareTest(domain, sample, pdf, 3, sample_count=100000, res=15, ires=12))


def check_sphere(bsdf, angle, ctx):
    """Chi² over the sphere of directions, for lobes that are not narrow."""
    wi = incident(angle)

    def sample(u):
        wo, _, valid = draw(bsdf, ctx, wi, u)
        return wo, dr.select(valid, 1.0, 0.0)

    def pdf(wo):
        return bsdf.pdf(ctx, interaction(wi + dr.zeros(mi.Vector3f, dr.width(wo))), wo)

    assert_accepted(ChiSquareTest(SphericalDomain(), sample, pdf, 3, sample_count=100000, res=101, ires=8))


SPECULAR = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.DeltaReflection


@pytest.mark.slow
@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("distribution", ("beckmann", "phong", "gaussian"))
@pytest.mark.parametrize("kind", ("conductor", "dielectric", "composite"))
def test_lobes_of_facets_are_drawn_with_their_density(variant_rgb, kind, distribution, alpha):
    bsdf = mi.load_dict({"type": f"prosim_{kind}"} | roughness(distribution, alpha))
    for angle in INCIDENCES + INSIDE * (kind == "dielectric"):
        check_facets(bsdf, angle, alpha, only(SPECULAR) if kind == "composite" else None)


#: An index that differs much, so that the lobes of r, g and b lie apart.
DISPERSIVE = {"type": "prosim_dielectric", "int_cauchy": "1.2, 0.08", "ext_ior": 1.0, "alpha": 0.25}


@pytest.mark.slow
@pytest.mark.parametrize("flags", (mi.BSDFFlags.All, mi.BSDFFlags.GlossyTransmission))
def test_dispersive_lobes_are_drawn_with_their_density(variant_rgb, flags):
    for angle in (50, 130):
        check_sphere(mi.load_dict(DISPERSIVE), angle, only(flags))


def test_numbers_side_by_side_give_directions_side_by_side(variant_rgb):
    """No choice between facets scatters what is stratified."""
    bsdf = mi.load_dict({"type": "prosim_conductor", "alpha": 0.3})
    n = 256
    i = dr.arange(mi.UInt32, n * n)
    u = mi.Point2f((mi.Float(i % n) + 0.5) / n, (mi.Float(i // n) + 0.5) / n)
    for angle in (0, 60):
        si = interaction(incident(angle) + dr.zeros(mi.Vector3f, n * n))
        wo = np.array(bsdf.sample(mi.BSDFContext(), si, mi.Float(0.5), u)[0].wo).T.reshape(n, n, 3)
        steps = np.linalg.norm(np.diff(wo, axis=0), axis=2)
        assert steps[:, : n * 9 // 10].max() < 0.1
