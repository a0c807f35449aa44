"""The materials in use: parameters, textures, nesting, attributes, derivatives, errors."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from drawing import curves
from mitsuba_prosim.optics.nested import ambient_reflectance
from scenes import FLAT, bitmap, derivative, load_scene, only, rgb, uniform, write_square

SPECULAR = mi.BSDFFlags.DeltaReflection


INDICES = {"type": "rgb", "value": [1.3, 1.8, 2.6]}
GROOVES = {"type": "prosim_conductor", "alpha": 0.4, "multiple_scattering": True}


@pytest.mark.parametrize("spectral", [False, True])
@pytest.mark.parametrize(
    "material, reflectance",
    [
        (
            {"type": "prosim_composite", "diffuse_reflectance": 0.0, "int_ior": INDICES, "ext_ior": 1.0},
            (0.0170, 0.1975),
        ),
        ({"type": "prosim_conductor", "eta": INDICES, "k": 0.0}, (0.0170, 0.1975)),
        ({"type": "prosim_conductor", "eta": 0.2, "k": {"type": "rgb", "value": [4.0, 3.0, 2.0]}}, (0.9541, 0.8529)),
    ],
)
def test_colours_of_indices_may_be_above_1(spectral, material, reflectance):
    """At the wavelengths of r and b a spectral variant has the reflectances of r and b; Mitsuba's colours end at 1."""
    mi.set_variant("llvm_ad_spectral" if spectral else "llvm_ad_rgb")
    si = curves.interaction(mi.Vector3f(0, 0, 1))
    if spectral:
        si.wavelengths = mi.UnpolarizedSpectrum(635, 635, 437, 437)
    weight = mi.load_dict(material).sample(only(SPECULAR), si, mi.Float(0.5), mi.Point2f(0.5))[1]
    assert np.ravel(weight)[[0, -1]] == pytest.approx(reflectance, abs=2e-4)


def test_colours_of_the_vertices_of_a_mesh_are_reflectances(variant_rgb, tmp_path):
    """A ``mesh_attribute`` has no ``max()``."""
    paint = {"type": "prosim_lambertian", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}}
    scene = load_scene(square=write_square(tmp_path / "square.ply", color=0.4) | {"bsdf": paint})
    si = scene.ray_intersect(mi.Ray3f([0, 0, 1], [0, 0, -1]))
    assert np.allclose(si.bsdf().eval_diffuse_reflectance(si), 0.4)


@pytest.mark.parametrize(
    "material",
    [
        {"type": "prosim_phong", "exponent": 20.0, "normalized": False},
        {"type": "prosim_conductor", "alpha": 0.2, "multiple_scattering": True},
    ],
)
def test_choices_of_a_model_are_no_parameters_of_a_scene(variant_rgb, material):
    bsdf = mi.load_dict(material)
    assert not {"normalized", "multiple_scattering"} & set(mi.traverse(bsdf).keys())
    assert "normalized = False" in str(bsdf) or "multiple_scattering = True" in str(bsdf)


@pytest.mark.parametrize(
    "parameter, material",
    (
        ("alpha", {"type": "prosim_conductor"}),
        ("alpha", {"type": "prosim_conductor", "distribution": "gaussian"}),
        ("exponent", {"type": "prosim_dielectric"}),
        ("eta", {"type": "prosim_conductor", "alpha": 0.3}),
        ("k", {"type": "prosim_conductor", "alpha": 0.3}),
        ("specular_reflectance", {"type": "prosim_conductor", "alpha": 0.3}),
        ("reflectance", {"type": "prosim_lambertian"}),
        ("specular_reflectance", {"type": "prosim_composite", "alpha": 0.3, "diffuse_reflectance": 0.1}),
        ("exponent", {"type": "prosim_composite"}),
        ("specular_reflectance", {"type": "prosim_phong", "exponent": 5.0}),
        ("exponent", {"type": "prosim_phong"}),
    ),
)
def test_a_texture_of_two_values_is_one_material_here_and_another_there(variant_rgb, parameter, material):
    low, high = (2.0, 30.0) if parameter == "exponent" else (0.2, 0.6)
    texture = bitmap(np.array([low, high]).reshape(1, 2, 1), filter_type="nearest")
    both = mi.load_dict(material | {parameter: texture})
    wi, wo = curves.direction([30.0]), curves.direction([35.0], -1)
    for uv, value in (((0.25, 0.25), low), ((0.75, 0.25), high)):
        si = curves.interaction(wi)
        si.uv = mi.Point2f(uv)
        constant = mi.load_dict(material | {parameter: value})
        expected, found = (np.array(b.eval(mi.BSDFContext(), si, wo)) for b in (constant, both))
        np.testing.assert_allclose(found, expected, rtol=1e-4)


@pytest.mark.parametrize("kind", ["prosim_conductor", "prosim_dielectric", "prosim_composite"])
def test_a_texture_may_be_smooth_in_places(variant_rgb, kind):
    bsdf = mi.load_dict({"type": kind, "alpha": bitmap(np.array([0.0, 0.3]).reshape(1, 2, 1))})
    u = np.random.default_rng(1).random((4, 1 << 16), dtype=np.float32)
    si = curves.interaction(mi.Vector3f(0.6, 0, 0.8) + dr.zeros(mi.Vector3f, 1 << 16))
    si.uv = mi.Point2f(u[0], 0.5)
    bs, weight = bsdf.sample(mi.BSDFContext(), si, mi.Float(u[1]), mi.Point2f(u[2:]))
    found = np.vstack([weight, bs.wo, *bsdf.eval_pdf(mi.BSDFContext(), si, bs.wo)])
    assert np.isfinite(found).all() and 0.2 < found[0].mean() < 1.01


def ambient_cases():
    """BSDFs, also within Mitsuba's adapters, with their reflectance of ambient light seen from the front and from the
    back. It is the diffuse reflectance of the two materials that the thesis gives one; others have none unless stated.
    """
    low, high = ({"type": "prosim_lambertian", "reflectance": x} for x in (0.4, 0.8))
    blend = {"type": "blendbsdf", "weight": 0.25, "a": low, "b": high}
    half = {"type": "blendbsdf", "weight": 0.5, "a": low, "b": {"type": "diffuse"}}
    return (
        (low, 0.4, 0),
        (low | {"ambient": 0.1}, 0.1, 0),
        ({"type": "prosim_composite", "diffuse_reflectance": 0.3}, 0.3, 0),
        *(({"type": f"prosim_{kind}", "ambient": 0.2}, 0.2, 0) for kind in ("phong", "conductor")),
        *(({"type": f"prosim_{kind}"}, 0, 0) for kind in ("phong", "conductor", "dielectric")),
        ({"type": "prosim_dielectric", "ambient": 0.3}, 0.3, 0.3),
        ({"type": "diffuse"}, 0, 0),
        ({"type": "mask", "opacity": 0.25, "a": low}, 0.1, 0),
        (blend, 0.5, 0),
        ({"type": "bumpmap", "texture": {"type": "checkerboard"}, "a": low}, 0.4, 0),
        ({"type": "normalmap", "normalmap": bitmap(FLAT), "a": low}, 0.4, 0),
        ({"type": "twosided", "a": low}, 0.4, 0.4),
        ({"type": "twosided", "a": low, "b": high}, 0.4, 0.8),
        ({"type": "twosided", "a": blend}, 0.5, 0.5),
        ({"type": "mask", "opacity": 0.5, "a": half}, 0.1, 0),
    )


def test_the_ambient_reflectance_is_the_diffuse_one_unless_stated(variant):
    cases = [(mi.load_dict(material), front, back) for material, front, back in ambient_cases()]
    for z, column in ((1, 1), (-1, 2)):
        si, expected = curves.interaction(mi.Vector3f(0, 0, z)), [case[column] for case in cases]
        for (bsdf, *_), value in zip(cases, expected):
            np.testing.assert_allclose(np.ravel(ambient_reflectance(bsdf, si)), value, rtol=1e-5)
        if variant == "llvm_ad_rgb":  # by a virtual call over all BSDFs at once
            pointers = dr.concat([mi.BSDFPtr(bsdf) for bsdf, *_ in cases])
            found = dr.dispatch(pointers, ambient_reflectance, si, mi.Bool(True))
            np.testing.assert_allclose(np.array(found)[1], expected, rtol=1e-5)


def test_metals_are_those_of_mitsuba(variant):
    si = curves.interaction(mi.Vector3f(0.6, 0, 0.8))
    for name in ("none", "Ag", "Cu", "Cu_palik", "Al", "TiO2-e_palik"):
        bsdfs = (mi.load_dict({"type": kind, "material": name}) for kind in ("prosim_conductor", "conductor"))
        (_, found), (_, expected) = (b.sample(mi.BSDFContext(), si, 0.5, [0.5, 0.5]) for b in bsdfs)
        np.testing.assert_allclose(np.ravel(found), np.ravel(expected), rtol=1e-6, err_msg=name)


def test_only_the_ratio_of_the_indices_of_a_metal_and_its_medium_matters(variant_rgb):
    water = mi.load_dict({"type": "prosim_conductor", "eta": 1.333, "k": 4.0, "ext_ior": "water"})
    air = mi.load_dict({"type": "prosim_conductor", "eta": 1.0, "k": 4.0 / 1.333})
    np.testing.assert_allclose(curves.reflectance(water, [0, 70]), curves.reflectance(air, [0, 70]), rtol=1e-5)


@pytest.mark.parametrize(
    "bsdf, albedo",
    [
        ({"type": "prosim_lambertian", "reflectance": 0.3}, 0.3),
        ({"type": "prosim_lambertian", "reflectance": bitmap(np.full((2, 2, 3), 1.5))}, 1),
        ({"type": "prosim_composite", "diffuse_reflectance": 0.3, "alpha": 0.05}, 0.3),
        ({"type": "prosim_phong", "diffuse_reflectance": 0.3}, 0.3),
        ({"type": "prosim_conductor", "specular_reflectance": 0.7}, 0.7),
        ({"type": "prosim_conductor", "eta": 1.5, "k": 0.0}, 0.04),
        ({"type": "prosim_dielectric"}, 1),
        ({"type": "prosim_dielectric", "int_ior": 1.5, "ext_ior": 1.0, "specular_transmittance": 0.0}, 0.04),
    ],
)
def test_albedo_is_the_colour_of_the_surface(variant_rgb, bsdf, albedo):
    """In [0, 1], whatever the roughness and the direction; also in other BSDFs."""
    has_facets = bsdf["type"] in ("prosim_conductor", "prosim_dielectric")
    for roughness in ({}, {"alpha": 0.05}, {"alpha": 0.5}, {"exponent": 900.0}) if has_facets else ({},):
        own = bsdf | roughness
        nested = [own, {"type": "mask", "b": own}, {"type": "blendbsdf", "a": own, "b": own, "weight": 0.5}]
        nested += [{"type": name, name: bitmap(FLAT), "b": own} for name in ("bumpmap", "normalmap")]
        if bsdf["type"] != "prosim_dielectric":
            nested.append({"type": "twosided", "b": own})
        si = curves.interaction(dr.normalize(mi.Vector3f([0, 0.6, 0.99], 0, [1, 0.7, 0.1])))
        for each in nested:
            assert np.allclose(np.array(mi.load_dict(each).eval_diffuse_reflectance(si)), albedo, atol=1e-5), each


@pytest.mark.parametrize("name", ["composite", "phong"])
@pytest.mark.parametrize("more", [{}, {"alpha": 0.2}], ids=["smooth", "rough"])
@pytest.mark.parametrize("kd, ks", [(0.95, 0.95), (1.5, 0.4), (0.2, 0.9)])
def test_changed_reflectances_create_no_energy(variant_rgb, name, more, kd, ks):
    """In a white furnace the mean of 65,536 samples is at most 1. The gradients are those of the limited values: none
    by ks, and by kd where it is at most 1.
    """
    more = more | {"int_ior": 10.0} if name == "composite" else {"exponent": 20.0} if more else {}
    bsdf = mi.load_dict({"type": f"prosim_{name}", "diffuse_reflectance": 0.3, "specular_reflectance": 0.4, **more})
    parameters = mi.traverse(bsdf)
    names = "diffuse_reflectance.value", "specular_reflectance.value"
    for key, value in zip(names, (kd, ks)):
        parameters[key] = mi.Float(value)
        dr.enable_grad(parameters[key])
    parameters.update()
    si = dr.zeros(mi.SurfaceInteraction3f, 1 << 16)
    si.wi = mi.Vector3f(0.6, 0, 0.8)
    _, weight = bsdf.sample(mi.BSDFContext(), si, *uniform(1 << 16))
    mean = dr.mean(weight.x)
    assert mean[0] <= 1.001 and mean[0] > 0.8 * min(kd, 1)
    wo = mi.Vector3f(-0.6, 0, 0.8)
    dr.backward(dr.mean(bsdf.eval(mi.BSDFContext(), si, wo).x))
    by_kd, by_ks = (dr.grad(parameters[key])[0] for key in names)
    assert np.isfinite([by_kd, by_ks]).all() and by_ks == 0 and (by_kd == 0) == (kd > 1)


@pytest.mark.parametrize("more", [{}, {"exponent": 20.0}], ids=["smooth", "rough"])
def test_spectra_of_colours_create_no_energy(variant_spectral, more):
    """The sum of the spectra is 1.99 at 780 nm. Colours whose own sum is above 1 keep it: it is the user's."""
    si = dr.zeros(mi.SurfaceInteraction3f, 1 << 16)
    si.wi, si.wavelengths = mi.Vector3f(0, 0, 1), mi.UnpolarizedSpectrum(400, 500, 600, 780)
    red = {"diffuse_reflectance": rgb(0.439, 0.07, 0.113)}
    for ks, expected in (rgb(0.56, 0.168, 0.886), 1), (rgb(0.7, 0.7, 0.9), 1.96):
        bsdf = mi.load_dict({"type": "prosim_phong", "specular_reflectance": ks, **red, **more})
        _, weight = bsdf.sample(mi.BSDFContext(), si, *uniform(1 << 16))
        assert np.mean(weight, axis=1)[3] == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize(
    "key, at, bsdf",
    [
        ("alpha.value", 0.4, {"type": "prosim_conductor", "alpha": 0.4}),
        pytest.param("alpha.value", 0.4, GROOVES, marks=pytest.mark.slow),
        ("alpha.value", 0.4, {"type": "prosim_dielectric", "alpha": 0.4}),
        ("eta", 1.5, {"type": "prosim_dielectric"}),
        ("eta", 1.5, {"type": "prosim_composite", "alpha": 0.4}),
        ("diffuse_reflectance.value", 0.3, {"type": "prosim_composite", "alpha": 0.4}),
        ("diffuse_reflectance.value", 0.3, {"type": "prosim_phong", "exponent": 9.0, "specular_reflectance": 0.5}),
    ],
)
def test_derivative_of_a_sample_is_a_finite_difference(variant_rgb, key, at, bsdf):
    """Of the light from a sky that is brighter on one side, in the mean of a million samples, as in ``direct``."""
    bsdf, n, h = mi.load_dict(bsdf), 1 << 20, 0.02
    params, si = mi.traverse(bsdf), dr.zeros(mi.SurfaceInteraction3f, n)
    si.wi = mi.Vector3f(0.8, 0, 0.6)
    u = uniform(n)

    def light(value):
        params[key] = value
        params.update()
        bs, weight = bsdf.sample(mi.BSDFContext(), si, *u)
        return dr.mean(weight.x * (1 + bs.wo.x))

    difference = (light(mi.Float(at + h)) - light(mi.Float(at - h)))[0] / (2 * h)
    assert derivative(light, at) == pytest.approx(difference, rel=0.02, abs=0.01)


def test_loaded_phong_keeps_a_sum_above_1(variant_rgb):
    bsdf = mi.load_dict({"type": "prosim_phong", "diffuse_reflectance": 0.8, "specular_reflectance": 0.6})
    si, context = curves.interaction(mi.Vector3f(0, 0, 1)), mi.BSDFContext()
    context.component = 0
    assert bsdf.sample(context, si, 0.5, mi.Point2f(0.5))[1].x[0] == pytest.approx(0.6)
