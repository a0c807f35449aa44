"""The materials where single precision is thin: grazing incidence, indices near 1, sharp lobes, extreme samples.

The reference is the same equations in double precision. A value may differ from it by rounding alone: by a part in
1,000, or by a few times what the last digit of the directions' components makes of it.
"""

import functools
import itertools

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from drawing.curves import interaction

GAUSSIAN = {"alpha": 0.3, "distribution": "gaussian"}
LOBES = ({"alpha": 0.02}, {"alpha": 0.5}, GAUSSIAN, {"exponent": 0.0}, {"exponent": 60.0}, {"exponent": 1e6})


@functools.cache
def gaussian_total(alpha):
    x = (np.arange(200000) + 0.5) / 200000 * np.pi / 2
    return np.pi * (np.exp(-((x / alpha) ** 2)) * np.sin(2 * x)).sum() * np.pi / 2 / 200000


def distribution(m, lobe):
    """D(m) in double precision."""
    cos, sin2 = m[2], m[0] ** 2 + m[1] ** 2
    if "exponent" in lobe:
        n = lobe["exponent"]
        return (n + 2) / (2 * np.pi) * np.exp(0.5 * n * np.log1p(-np.minimum(sin2, 1 - 1e-15)))
    alpha = lobe["alpha"]
    if lobe.get("distribution") == "gaussian":
        return np.exp(-((np.arctan2(np.sqrt(sin2), cos) / alpha) ** 2)) / gaussian_total(alpha)
    cos2 = np.maximum(cos * cos, 1e-30)
    return np.exp(-sin2 / cos2 / alpha**2) / (np.pi * alpha**2 * cos2**2)


def g1(cos_w, cos_m, w_m):
    return np.minimum(1, 2 * cos_m * cos_w / w_m)


def dielectric(cos, eta):
    """Fresnel's reflectance in double precision; ``eta``: index beyond over that on the incident side."""
    t2 = 1 - (1 - cos * cos) / eta**2
    t = np.sqrt(np.maximum(t2, 0))
    s = (1 - eta**2) / (cos + eta * t) ** 2
    p = (eta**2 - 1) * (cos**2 * (eta**2 + 1) - 1) / (eta * (eta * cos + t)) ** 2
    return np.where(t2 > 0, 0.5 * (s * s + p * p), 1)


def reflected(wi, wo, lobe):
    """Equation 3.1 without Fresnel's reflectance, times cos_o; its density; the cosine at the facet."""
    h = wi + wo
    length = np.sqrt((h * h).sum(0))
    m, i_m = h / length, length / 2
    d = distribution(m, lobe) / (4 * wi[2])
    return d * g1(np.minimum(wi[2], wo[2]), m[2], i_m), d * g1(wi[2], m[2], i_m), i_m


def conductor(wi, wo, lobe):
    return reflected(wi, wo, lobe)[:2]


def composite(wi, wo, lobe, kd=0.3, ks=0.6, eta=1.5):
    value, pdf, i_m = reflected(wi, wo, lobe)
    f = ks * dielectric(wi[2], eta)
    p = f / (f + kd)
    return kd * wo[2] / np.pi + ks * dielectric(i_m, eta) * value, (1 - p) * wo[2] / np.pi + p * pdf


def phong(wi, wo, lobe, kd=0.3, ks=0.6):
    n = lobe["exponent"]
    versine = 0.5 * ((wi * [[-1], [-1], [1]] - wo) ** 2).sum(0)
    power = np.where(versine < 1, np.exp(n * np.log1p(-np.minimum(versine, 1 - 1e-12))), 0) / (2 * np.pi)
    literal = "normalized" in lobe  # I_r = I_i (kd cos + ks cos^n)
    factor, share = (2 * wo[2] / wi[2], 2 * ks / (n + 1)) if literal else ((n + 2) * wo[2], ks)
    p = share / (share + kd)
    return kd * wo[2] / np.pi + ks * factor * power, (1 - p) * wo[2] / np.pi + p * (n + 1) * power


def glass(wi, wo, lobe, eta):
    """Reflection and refraction from both sides, in importance (no scaling of radiance)."""
    side = np.where(wi[2] > 0, eta, 1 / eta)
    back = (wi[2] > 0) == (wo[2] > 0)
    h = wi + wo * np.where(back, 1, side)
    length = np.sqrt((h * h).sum(0))
    m = h / length * np.where(h[2] < 0, -1, 1)
    i_m, o_m = (wi * m).sum(0), (wo * m).sum(0)
    i_m, o_m = (np.where(back, length / 2 * np.sign(wi[2]), x) for x in (i_m, o_m))
    a, b = np.abs(i_m), np.abs(o_m)
    jacobian = np.where(back, 0.25 / b, side**2 * b / length**2)
    d = distribution(m, lobe) * a / np.abs(wi[2]) * jacobian
    gi, go = g1(np.abs(wi[2]), m[2], a), g1(np.abs(wo[2]), m[2], b)
    f = dielectric(a, side)
    share = np.where(back, f, 1 - f)
    valid = (i_m * wi[2] > 0) & (o_m * wo[2] > 0)
    value = d * np.where(back, np.minimum(gi, go), gi * go) * share
    return np.where(valid, value, 0), np.where(valid, d * gi * share, 0)


def grazing_pairs(n, rng, least=1e-12):
    """Both directions near the horizon, opposite or nearly: where wi + wo is short."""
    elevation = np.exp(rng.uniform(np.log(least), np.log(0.3), (2, n)))
    azimuth = rng.uniform(0, 2 * np.pi, n)
    other = azimuth + np.pi + rng.normal(size=n) * rng.choice([0, 1e-6, 1e-4, 1e-2, 1], n)
    cos = np.sqrt(1 - elevation**2)
    rows = zip(cos, (azimuth, other), elevation)
    return [np.stack([c * np.cos(a), c * np.sin(a), e]) for c, a, e in rows]


def mirror_pairs(n, rng, width):
    """Directions about each other's mirror image, off by about ``width``."""
    wi = rng.normal(size=(3, n))
    wi[2] = np.abs(wi[2])
    wi /= np.linalg.norm(wi, axis=0)
    wo = wi * [[-1], [-1], [1]] + width * rng.normal(size=(3, n))
    wo[2] = np.abs(wo[2])
    return wi, wo / np.linalg.norm(wo, axis=0)


def refracted_pairs(n, rng, eta, width):
    """Directions about each other's refraction, from both sides."""
    wi = rng.normal(size=(3, n))
    wi /= np.linalg.norm(wi, axis=0)
    side = np.where(wi[2] > 0, eta, 1 / eta)
    m = width * rng.normal(size=(3, n)) + [[0], [0], [1]]
    m = m / np.linalg.norm(m, axis=0) * np.sign(wi[2])
    c = (wi * m).sum(0)
    t2 = 1 - (1 - c * c) / side**2
    wo = m * (c / side - np.sqrt(np.maximum(t2, 0))) - wi / side
    keep = (t2 > 0) & (c > 0) & (wo[2] * wi[2] < 0)
    return wi[:, keep], (wo / np.linalg.norm(wo, axis=0))[:, keep]


def values(bsdf, wi, wo):
    context = mi.BSDFContext(mi.TransportMode.Importance)
    value, pdf = bsdf.eval_pdf(context, interaction(mi.Vector3f(wi)), mi.Vector3f(wo))
    return np.array(value, dtype=float)[0], np.array(pdf, dtype=float)


def assert_as_in_double_precision(bsdf, reference, wi, wo, rng):
    wi, wo = np.float32(wi), np.float32(wo)  # as they are stored
    above = (wi[2] != 0) & (wo[2] != 0)
    wi, wo = wi[:, above], wo[:, above]
    found = values(bsdf, wi, wo)

    wi, wo = np.float64(wi), np.float64(wo)
    expected = np.array(reference(*(w / np.sqrt((w * w).sum(0)) for w in (wi, wo))))
    wiggles = (1 + 1.2e-7 * rng.choice([-1, 1], (2, *wi.shape)) for _ in range(16))
    slack = np.max([np.abs(reference(wi * a, wo * b) - expected) for a, b in wiggles], axis=0)
    for a, b, c in zip(found, expected, slack, strict=True):
        assert np.isfinite(a).all() and (a >= 0).all()
        excess = np.abs(a - b) - 1e-3 * b - 16 * c - 1e-6
        worst = excess.argmax()
        assert excess[worst] <= 0, f"{a[worst]} for {b[worst]} at {wi[:, worst]}, {wo[:, worst]}"


GLASS = {"int_ior": 1.5, "ext_ior": 1.0}
PAINT = {"diffuse_reflectance": 0.3, "specular_reflectance": 0.6}
REFLECTING = (
    ("prosim_conductor", conductor, {"eta": 0.0, "k": 1e8}, LOBES),
    ("prosim_composite", composite, GLASS | PAINT, LOBES),
    ("prosim_dielectric", lambda wi, wo, lobe: glass(wi, wo, lobe, 1.5), GLASS, LOBES),
    ("prosim_phong", phong, PAINT, [lobe for lobe in LOBES if "exponent" in lobe]),
    ("prosim_phong", phong, PAINT, [{"exponent": n, "normalized": False} for n in (0.0, 100.0)]),
)


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind, reference, parameters, lobe",
    [(*row, lobe) for *row, lobes in REFLECTING for lobe in lobes],
    ids=lambda value: getattr(value, "__name__", str(value)),
)
def test_reflection_is_as_in_double_precision(variant_rgb, kind, reference, parameters, lobe):
    rng = np.random.default_rng(5)
    pairs = (grazing_pairs(10000, rng), *(mirror_pairs(3000, rng, width) for width in (1e-3, 0.1, 1)))
    wi, wo = (np.hstack(w) for w in zip(*pairs, strict=True))
    bsdf = mi.load_dict({"type": kind, **parameters, **lobe})
    assert_as_in_double_precision(bsdf, lambda a, b: reference(a, b, lobe), wi, wo, rng)


@pytest.mark.slow
@pytest.mark.parametrize("eta", (2.4, 1 / 1.5, 1.01, 1.001, 1 - 1e-4))
@pytest.mark.parametrize("lobe", LOBES, ids=str)
def test_refraction_is_as_in_double_precision(variant_rgb, lobe, eta):
    rng = np.random.default_rng(6)
    bsdf = mi.load_dict({"type": "prosim_dielectric", "int_ior": eta, "ext_ior": 1.0, **lobe})
    pairs = (refracted_pairs(5000, rng, eta, width) for width in (0.01, 0.3))
    wi, wo = (np.hstack(w) for w in zip(*pairs, strict=True))
    assert_as_in_double_precision(bsdf, lambda a, b: glass(a, b, lobe, float(np.float32(eta))), wi, wo, rng)


ELEVATIONS = (1.0, 1e-3, 1e-7, 1e-12, 1e-17, 1e-19, 1e-30, 1e-40, 1e-45, 0.0, -1e-45, -1e-20, -1e-7, -1.0)
EDGES = (0.0, 1e-45, 1e-20, 1e-7, 0.5, 1 - 2**-24)
POWERS = ({}, {"exponent": 0.0}, {"exponent": 30.0}, {"exponent": 1e6})
GAUSSIANS = tuple({"alpha": alpha, "distribution": "gaussian"} for alpha in (2.0, 1e-4))
EDGE_LOBES = (*POWERS, *GAUSSIANS, {"alpha": 1e-4}, {"alpha": 0.2}, {"alpha": 5.0})
FACETS = ("prosim_conductor", "prosim_composite", "prosim_dielectric")
MATERIALS = [
    *({"type": kind, **lobe} for kind in FACETS for lobe in EDGE_LOBES),
    *({"type": "prosim_phong", **lobe} for lobe in POWERS),
    *({"type": "prosim_phong", "normalized": False, **lobe} for lobe in POWERS[1:]),
    {"type": "prosim_lambertian"},
    {"type": "prosim_dielectric", "int_ior": 1.00001, "ext_ior": 1.0, "alpha": 0.1},
    {"type": "prosim_conductor", "material": "Cu", "fresnel": "thesis", "alpha": 0.2},
]


def directions():
    """Unit vectors of all elevations, some of them along an axis or with denormal components."""
    for z, angle in itertools.product(ELEVATIONS, (0.0, 0.7, np.pi / 2, np.pi, 1e-40)):
        cos = np.sqrt(max(0, 1 - z * z))
        yield cos * np.cos(angle), cos * np.sin(angle), z


@pytest.mark.parametrize("material", MATERIALS, ids=lambda m: "-".join(map(str, m.values())))
def test_every_pair_of_directions_has_a_finite_value(variant_rgb, material):
    bsdf = mi.load_dict(material)
    wi, wo = np.array(list(itertools.product(directions(), repeat=2))).transpose(1, 2, 0)
    for value in values(bsdf, wi, wo):
        assert np.isfinite(value).all() and (value >= 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("material", MATERIALS, ids=lambda m: "-".join(map(str, m.values())))
def test_samples_at_the_edges_of_the_unit_square(variant_rgb, material):
    """A sample that has a density is a unit vector, its weight finite and its density that of ``pdf``."""
    wi, u = zip(*itertools.product(directions(), itertools.product(EDGES, repeat=3)), strict=True)
    wi, u = np.array(wi).T, np.array(u).T
    bsdf = mi.load_dict(material)
    si = interaction(mi.Vector3f(wi))
    bs, weight = bsdf.sample(mi.BSDFContext(), si, mi.Float(u[0]), mi.Point2f(u[1:]))
    weight, pdf, wo = np.array(weight, dtype=float), np.array(bs.pdf, dtype=float), np.array(bs.wo, dtype=float)
    assert np.isfinite(weight).all() and (weight >= 0).all() and np.isfinite(pdf).all() and (pdf >= 0).all()
    assert np.isfinite(wo).all()
    assert (weight[:, pdf == 0] == 0).all()
    drawn = pdf > 0
    np.testing.assert_allclose(np.linalg.norm(wo[:, drawn], axis=0), 1, atol=1e-5)
    assert drawn[wi[2] > 1e-6].mean() > 0.4


def test_scalar_samples_at_the_edges_are_finite(variant_scalar):
    incident = ((0, 0, 1), (1, 0, 1e-40), (0.6, 0, 0.8), (1, 0, 1e-7))
    samples = list(itertools.product((0.0, 1 - 2**-24), repeat=3))
    for material in MATERIALS:
        bsdf = mi.load_dict(material)
        for wi, u in itertools.product(incident, samples):
            si = interaction(mi.Vector3f(*wi))
            bs, weight = bsdf.sample(mi.BSDFContext(), si, u[0], mi.Point2f(*u[1:]))
            value, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, bs.wo)
            assert all(np.isfinite(np.array(x)).all() for x in (bs.wo, bs.pdf, weight, value, pdf))
            assert dr.all(weight == 0) or bs.pdf > 0
