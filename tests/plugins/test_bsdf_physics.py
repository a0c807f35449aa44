"""Conservation of energy, stratified samples, and equality with Mitsuba's own where the physics is equal."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from drawing import curves
from scenes import grid, uniform

COPPER = {"eta": {"type": "rgb", "value": [0.2, 0.92, 1.1]}, "k": {"type": "rgb", "value": [3.9, 2.45, 2.14]}}


def label(d):
    return "-".join(str(v) for v in d.values() if isinstance(v, (str, float))) if isinstance(d, dict) else None


def directions(n, seed):
    v = np.random.default_rng(seed).normal(size=(3, n))
    return mi.Vector3f(v / np.linalg.norm(v, axis=0))


def spectrum(value):
    return np.array(mi.unpolarized_spectrum(value))


STRIPES = {"type": "prosim_stripes", "color0": 0.2, "color1": 0.9}
PEAKS = {"type": "spectrum", "value": [(400, 0.9), (500, 0.1), (550, 0.8), (700, 0.2)]}
HALVES = {"type": "spectrum", "value": [(400, 0.1), (410, 0.9), (700, 0.1)]}
GREENISH = {"type": "rgb", "value": [0.05, 0.9, 0.05]}
PAINTS = [
    {"type": "prosim_composite", "alpha": 0.1, **{f"{name}_reflectance": value for name, value in given.items()}}
    for given in (
        {"diffuse": STRIPES, "specular": STRIPES},
        {"diffuse": STRIPES},
        {"diffuse": PEAKS, "specular": 0.5},
        {"diffuse": HALVES, "specular": HALVES | {"value": [(400, 0.1), (690, 0.95), (700, 0.1)]}},
        {"diffuse": GREENISH, "specular": {"type": "rgb", "value": [0.95, 0.1, 0.95]}},
    )
]
PAINTS.append({name: value for name, value in PAINTS[0].items() if name != "alpha"})


@pytest.mark.slow
@pytest.mark.parametrize("bsdf", PAINTS, ids=label)
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


def test_numbers_side_by_side_give_directions_side_by_side(variant_rgb):
    """No choice between facets scatters what is stratified."""
    bsdf, n = mi.load_dict({"type": "prosim_conductor", "alpha": 0.3}), 256
    for angle in (0, 60):
        si = curves.interaction(curves.direction(angle) + dr.zeros(mi.Vector3f, n * n))
        wo = np.array(bsdf.sample(mi.BSDFContext(), si, mi.Float(0.5), grid(n))[0].wo).T.reshape(n, n, 3)
        steps = np.linalg.norm(np.diff(wo, axis=0), axis=2)
        assert steps[:, : n * 9 // 10].max() < 0.1


@pytest.mark.parametrize("mode", (mi.TransportMode.Radiance, mi.TransportMode.Importance))
@pytest.mark.parametrize(
    "ours, theirs, parameters",
    (
        ("prosim_conductor", "conductor", COPPER | {"specular_reflectance": 0.9}),
        ("prosim_dielectric", "dielectric", {"int_ior": "water", "ext_ior": "bk7", "specular_transmittance": 0.5}),
    ),
    ids=label,
)
def test_smooth_materials_are_those_of_mitsuba(variant_rgb, ours, theirs, parameters, mode):
    ours, theirs = (mi.load_dict({"type": kind, **parameters}) for kind in (ours, theirs))
    context = mi.BSDFContext(mode)
    wi, wo = directions(5000, 7), directions(5000, 8)
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
