"""Reciprocity, conservation of energy, bounded weights, and equality with Mitsuba's own where the physics is equal."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from drawing import curves
from mitsuba_prosim.optics import fresnel
from scenes import derivative, grid, only

COPPER = {"eta": {"type": "rgb", "value": [0.2, 0.92, 1.1]}, "k": {"type": "rgb", "value": [3.9, 2.45, 2.14]}}
GAUSSIAN = {"alpha": 0.3, "distribution": "gaussian"}
LOBES = [{"alpha": 0.05}, {"alpha": 0.3}, {"alpha": 1.0}, {"exponent": 3.0}, {"exponent": 300.0}, GAUSSIAN]
PHONG = {"type": "prosim_phong", "diffuse_reflectance": 0.6, "specular_reflectance": 0.4}
ROUGH = (
    [{"type": "prosim_conductor", **COPPER, **lobe} for lobe in LOBES]
    + [{"type": "prosim_dielectric", "int_ior": 1.5, "ext_ior": 1.0, **lobe} for lobe in LOBES]
    + [{"type": "prosim_composite", "diffuse_reflectance": 0.4, **lobe} for lobe in LOBES]
    + [PHONG | {"exponent": n} for n in (0.0, 5.0, 100.0)]
    + [{"type": "prosim_lambertian", "reflectance": {"type": "rgb", "value": [0.9, 0.5, 0.1]}}]
)
#: Light between the facets of a groove is added.
GROOVES = [{**bsdf, "multiple_scattering": True} for bsdf in ROUGH[:18]]
#: Phong's model without its normalisation.
LITERAL = [PHONG | {"exponent": n, "normalized": False} for n in (0.0, 5.0, 100.0)]
SMOOTH = [
    {"type": "prosim_conductor", **COPPER},
    {"type": "prosim_dielectric"},
    {"type": "prosim_composite", "diffuse_reflectance": 0.4},
    {"type": "prosim_phong"},
]
FEW = [ROUGH[1], ROUGH[7], ROUGH[17], ROUGH[19], ROUGH[21], *SMOOTH]
SPECULAR = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.DeltaReflection
TRANSMITTED = mi.BSDFFlags.GlossyTransmission | mi.BSDFFlags.DeltaTransmission


def label(d):
    return "-".join(str(v) for v in d.values() if isinstance(v, (str, float))) if isinstance(d, dict) else None


def each(bsdfs):
    return pytest.mark.parametrize("bsdf", bsdfs, ids=label)


def directions(n, seed, sides=False):
    v = np.random.default_rng(seed).normal(size=(3, n))
    v /= np.linalg.norm(v, axis=0)
    if not sides:
        v[2] = np.abs(v[2])
    return mi.Vector3f(v)


def spectrum(value):
    return np.array(mi.unpolarized_spectrum(value))


def uniform(n, seed):
    u = np.random.default_rng(seed).random((3, n))
    return mi.Float(u[0]), mi.Point2f(u[1:])


@each([*ROUGH, *LITERAL, *GROOVES])
def test_bsdfs_are_reciprocal(variant_rgb, bsdf):
    """f(i, o) = f(o, i); through an interface, the radiance one way is the importance the other way."""
    bsdf = mi.load_dict(bsdf)
    wi, wo = directions(20000, 1, True), directions(20000, 2, True)
    there = bsdf.eval(mi.BSDFContext(), curves.interaction(wi), wo) / dr.abs(wo.z)
    back = bsdf.eval(mi.BSDFContext(mi.TransportMode.Importance), curves.interaction(wo), wi) / dr.abs(wi.z)
    there, back = spectrum(there), spectrum(back)
    assert (there > 1e-3).any()
    off = ~np.isclose(there, back, rtol=1e-4, atol=1e-4 * there.mean())
    assert off.mean() < 1e-3  # floats are coarse at the critical angle
    np.testing.assert_allclose(there, back, rtol=2e-2, atol=1e-4 * there.mean())


@each(LITERAL)
def test_literal_phong_is_the_equation_of_the_thesis(variant_rgb, bsdf):
    """I_r = I_i (kd cos + ks cos^n), where pi I_i is the irradiance on a surface that faces the light."""
    wi, wo = directions(20000, 1), directions(20000, 2)
    si, ctx = curves.interaction(wi), mi.BSDFContext()
    cos = (np.array(mi.reflect(wi), dtype=float) * np.array(wo, dtype=float)).sum(axis=0)
    lobe = np.where(cos > 0, np.abs(cos) ** bsdf["exponent"], 0)
    expected = (bsdf["diffuse_reflectance"] * np.array(wo.z) + bsdf["specular_reflectance"] * lobe) / np.pi
    loaded = mi.load_dict(bsdf)
    np.testing.assert_allclose(spectrum(loaded.eval(ctx, si, wo))[0], expected, rtol=1e-4, atol=1e-6)
    # A sample of the lobe has the same weight everywhere, 2 ks / (n + 1); grazing light keeps values finite.
    bs, weight = loaded.sample(only(SPECULAR), si, *uniform(20000, 3))
    weight = spectrum(weight)[0][np.array(bs.pdf) > 0]
    np.testing.assert_allclose(weight, 2 * bsdf["specular_reflectance"] / (bsdf["exponent"] + 1), rtol=1e-3)
    low = mi.Vector3f(1, 0, 0) + mi.Vector3f(0, 0, mi.Float(np.geomspace(1e-7, 1e-3, 50)))
    for mode in (mi.TransportMode.Radiance, mi.TransportMode.Importance):
        value = loaded.eval(mi.BSDFContext(mode), curves.interaction(low), mi.Vector3f(-low.x, 0, low.z))
        assert np.isfinite(spectrum(value)).all()


STRIPES = {"type": "prosim_stripes", "color0": 0.2, "color1": 0.9}
PEAKS = {"type": "spectrum", "value": [(400, 0.9), (500, 0.1), (550, 0.8), (700, 0.2)]}
HALVES = {"type": "spectrum", "value": [(400, 0.1), (410, 0.9), (700, 0.1)]}
GREENISH = {"type": "rgb", "value": [0.05, 0.9, 0.05]}
PAINTS = [
    {"type": "prosim_composite", **lobe, **{f"{name}_reflectance": value for name, value in given.items()}}
    for lobe in ({}, {"alpha": 0.1})
    for given in (
        {"diffuse": STRIPES, "specular": 0.7},
        {"diffuse": 0.4, "specular": STRIPES},
        {"diffuse": STRIPES, "specular": STRIPES},
        {"diffuse": STRIPES},
        {"specular": STRIPES},
        {"diffuse": PEAKS, "specular": 0.5},
        {"diffuse": PEAKS, "specular": {"type": "spectrum", "value": [(400, 0.9), (700, 0.9)]}},
        {"diffuse": HALVES, "specular": HALVES | {"value": [(400, 0.1), (690, 0.95), (700, 0.1)]}},
        {"diffuse": HALVES, "specular": GREENISH},
        {"diffuse": GREENISH, "specular": {"type": "rgb", "value": [0.95, 0.1, 0.95]}},
    )
]


@pytest.mark.slow
@each(PAINTS)
@pytest.mark.parametrize("variant", ("llvm_ad_rgb", "llvm_ad_spectral"))
def test_paint_reflects_at_most_what_arrives(variant, bsdf):
    """The mean weight of samples is the reflected share of the light, here within 4 standard errors."""
    mi.set_variant(variant)
    bsdf, n = mi.load_dict(bsdf), 20000
    for angle in (0, 30, 60, 85, 89.5):
        for place in (0.0, 0.1):  # a stripe of either colour
            si = curves.interaction(curves.direction(angle) + dr.zeros(mi.Vector3f, n))
            si.uv = mi.Point2f(dr.opaque(mi.Float, place), 0)
            weight = spectrum(bsdf.sample(mi.BSDFContext(mi.TransportMode.Importance), si, *uniform(n, 1))[1])
            error = 4 * weight.std(axis=1) / n**0.5
            assert (weight.mean(axis=1) <= 1 + 1e-5 + error).all()


def test_paint_keeps_the_sum_of_textures(variant_rgb):
    """A specular weight that is too high beside the pigment counts as what is left."""
    si = curves.interaction(curves.direction([30.0]))
    si.uv = mi.Point2f(0.1, 0)  # 0.9
    wo = curves.direction([35.0], -1)
    for kd, ks, same in ((STRIPES, 0.7, 0.1), (0.4, STRIPES, 0.6)):
        values = []
        for d, s in ((kd, ks), (0.9 if kd is STRIPES else kd, same)):
            paint = {"type": "prosim_composite", "alpha": 0.2, "diffuse_reflectance": d, "specular_reflectance": s}
            values.append(mi.load_dict(paint).eval(mi.BSDFContext(), si, wo))
        np.testing.assert_allclose(*values, rtol=1e-5)


@each([b for b in ROUGH + SMOOTH if b["type"] != "prosim_phong"])
def test_weights_do_not_exceed_fresnels_reflectance(variant_rgb, bsdf):
    """With one specular component enabled, a sample weighs at most F (or 1 - F) of its facet.

    F has a vertical tangent at the critical angle, so the tolerance is on the cosine: a few units in its last place, by
    which processors differ.
    """
    kind = bsdf["type"]
    bsdf = mi.load_dict(bsdf)
    wi = directions(50000, 3, kind == "prosim_dielectric")
    si = curves.interaction(wi)
    bs, weight = bsdf.sample(only(SPECULAR), si, *uniform(50000, 4))
    cos = dr.dot(wi, dr.normalize(wi + bs.wo))

    def reflected(cos):
        if kind == "prosim_lambertian":
            return mi.Color3f(0)
        if kind == "prosim_conductor":
            return fresnel.conductor(cos, mi.Color3f(COPPER["eta"]["value"]), mi.Color3f(COPPER["k"]["value"]))
        eta = mi.traverse(bsdf)["eta"]
        return mi.Color3f(fresnel.interface(dr.mulsign(cos, wi.z), eta).f) * (0.6 if kind == "prosim_composite" else 1)

    bound = dr.maximum(reflected(dr.maximum(cos - 1e-6, 0)), reflected(dr.minimum(cos + 1e-6, 1)))
    assert dr.all(weight <= bound * (1 + 1e-4) + 1e-5, axis=None)
    if kind == "prosim_dielectric":
        bs, weight = bsdf.sample(only(TRANSMITTED), si, *uniform(50000, 4))
        assert dr.all(weight <= 1 / dr.square(bs.eta) * (1 + 1e-4), axis=None)


METAL, PAINT = (
    {"type": "prosim_conductor", "eta": 0.3, "k": 2.0},
    {"diffuse_reflectance": 0.4, "specular_reflectance": 0.4},
)
FACETED = [METAL, {"type": "prosim_dielectric"}, {"type": "prosim_composite", **PAINT}]
DIFFERENTIATED = [
    bsdf | lobe | {"multiple_scattering": grooves}
    for bsdf in FACETED
    for lobe in ({"alpha": 0.3}, {"exponent": 4.0}, {"alpha": 0.8, "distribution": "gaussian"})
    for grooves in (False, True)
]
DIFFERENTIATED += [METAL | {"alpha": 0.3, "fresnel": "thesis"}, {"type": "prosim_lambertian"}]
DIFFERENTIATED += [{"type": "prosim_phong", "exponent": 20.0, **PAINT}]


@pytest.mark.slow
@each(DIFFERENTIATED)
def test_derivatives_match_differences(variant_rgb, bsdf):
    """Of the sum of values at 256 pairs of directions, by every number and colour."""
    bsdf = mi.load_dict(bsdf)
    params, si, wo = mi.traverse(bsdf), curves.interaction(directions(256, 20, True)), directions(256, 21, True)
    for key in [key for key, _ in params if not params.flags(key) & mi.ParamFlags.NonDifferentiable]:
        start = type(params[key])(params[key])

        def total(e, key=key, start=start):
            params[key] = start * (1 + e)
            params.update()
            return dr.sum(bsdf.eval(mi.BSDFContext(), si, wo), axis=None)

        low, high = (total(mi.Float(e))[0] for e in (-4e-3, 4e-3))
        assert derivative(total) == pytest.approx((high - low) / 8e-3, rel=0.01, abs=1e-3), key
        total(mi.Float(0))


def test_numbers_side_by_side_give_directions_side_by_side(variant_rgb):
    """No choice between facets scatters what is stratified."""
    bsdf, n = mi.load_dict({"type": "prosim_conductor", "alpha": 0.3}), 256
    for angle in (0, 60):
        si = curves.interaction(curves.direction(angle) + dr.zeros(mi.Vector3f, n * n))
        wo = np.array(bsdf.sample(mi.BSDFContext(), si, mi.Float(0.5), grid(n))[0].wo).T.reshape(n, n, 3)
        steps = np.linalg.norm(np.diff(wo, axis=0), axis=2)
        assert steps[:, : n * 9 // 10].max() < 0.1


def contexts(bsdf):
    """Every context with one or two types of components and the number of one or all, and the components in it."""
    lobes = ("Diffuse", "Glossy", "Delta")
    names = ("Null", *(lobe + side for lobe in lobes for side in ("Reflection", "Transmission")))
    single = [+getattr(mi.BSDFFlags, name) for name in names]
    for mask in {a | b for a in single for b in single} | {+mi.BSDFFlags.All}:
        types = [+bsdf.flags(k) & +mi.BSDFFlags.All for k in range(bsdf.component_count())]
        for component in (0xFFFFFFFF, *range(3)):
            context = mi.BSDFContext()
            context.type_mask, context.component = mask, component
            yield context, [k for k, t in enumerate(types) if component in (0xFFFFFFFF, k) and t & ~mask == 0]


@each(FEW)
def test_a_context_is_honoured_exactly(variant_rgb, bsdf):
    """A sample is of a component that was asked for; values and densities are the sums of what such components give."""
    bsdf = mi.load_dict(bsdf)
    n = 2000
    si, wo, numbers = curves.interaction(directions(n, 12, True)), directions(n, 13, True), uniform(n, 14)
    alone = {}
    for k in range(bsdf.component_count()):
        context = mi.BSDFContext()
        context.component = k
        alone[k] = spectrum(bsdf.eval(context, si, wo))
    for context, allowed in contexts(bsdf):
        bs, weight = bsdf.sample(context, si, *numbers)
        value, pdf = bsdf.eval_pdf(context, si, wo)
        drawn = np.broadcast_to(np.array(bs.pdf), n) > 0
        kind, component = (np.broadcast_to(np.array(x), n)[drawn] for x in (bs.sampled_type, bs.sampled_component))
        assert drawn.any() == bool(allowed)
        assert set(component.tolist()) <= set(allowed) and not (kind & ~np.uint32(context.type_mask)).any()
        for k in set(component.tolist()):
            assert (kind[component == k] == (+bsdf.flags(k) & +mi.BSDFFlags.All)).all()
        expected = sum((alone[k] for k in allowed), np.zeros((3, 1)))
        np.testing.assert_allclose(*np.broadcast_arrays(spectrum(value), expected), rtol=1e-4, atol=1e-6)
        if not allowed:
            assert not np.array(pdf).any() and not spectrum(weight).any()


@pytest.mark.parametrize("mode", (mi.TransportMode.Radiance, mi.TransportMode.Importance))
@pytest.mark.parametrize(
    "ours, theirs, parameters",
    (
        ("prosim_lambertian", "diffuse", {"reflectance": 0.7}),
        ("prosim_conductor", "conductor", {"material": "Au"}),
        ("prosim_conductor", "conductor", COPPER | {"specular_reflectance": 0.9}),
        ("prosim_dielectric", "dielectric", {}),
        ("prosim_dielectric", "dielectric", {"int_ior": "water", "ext_ior": "bk7", "specular_transmittance": 0.5}),
    ),
    ids=label,
)
def test_smooth_materials_are_those_of_mitsuba(variant_rgb, ours, theirs, parameters, mode):
    ours, theirs = (mi.load_dict({"type": kind, **parameters}) for kind in (ours, theirs))
    context = mi.BSDFContext(mode)
    wi, wo = directions(5000, 7, True), directions(5000, 8, True)
    si = curves.interaction(wi)
    choice, point = uniform(5000, 9)
    a, b = (bsdf.sample(context, si, choice, point) for bsdf in (ours, theirs))
    seen = dr.any(mi.unpolarized_spectrum(b[1]) > 0)
    # Where the choice equals the reflectance but for rounding, either component is right.
    seen &= dr.abs(choice - dr.select(b[0].sampled_component == 0, b[0].pdf, 1 - b[0].pdf)) > 1e-5
    np.testing.assert_allclose(spectrum(a[1] & seen), spectrum(b[1] & seen), rtol=1e-5, atol=1e-6)
    for field in ("wo", "pdf", "eta", "sampled_type", "sampled_component"):
        x, y = (np.array(dr.select(seen, getattr(s, field), 0)) for s in (a[0], b[0]))
        np.testing.assert_allclose(x, y, rtol=1e-5, atol=1e-6, err_msg=field)
    np.testing.assert_allclose(spectrum(ours.eval(context, si, wo)), spectrum(theirs.eval(context, si, wo)), rtol=1e-5)
    np.testing.assert_allclose(ours.pdf(context, si, wo), theirs.pdf(context, si, wo), rtol=1e-5)
    assert +ours.flags() == +theirs.flags()
