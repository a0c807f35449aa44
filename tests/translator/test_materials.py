"""SURFACE statements: what their parameters mean, measured on the materials of both targets."""

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import prosim_scene
import pytest

pytestmark = pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")

SCENE = "LIGHTS POINT position 0 0 9 CSG-TREE SPHERE 0 SURFACE 0 {} TRANSFORM 0 END"
MATERIALS = {
    "conductor": "material conductor silver",
    "composite": "material composite n-refr = 1.5 kd = 0",
    "dielectric": "material dielectric n-refr = 1.5",
    "phong": "kd = .1 ks = .5",
}


def loaded(write_scene, surface, target="prosim", **statements):
    """The dictionary of a scene with ``statements`` and a SURFACE with the parameters ``surface``."""
    text = " ".join([f"{key} {value}" for key, value in statements.items()] + [SCENE.format(surface)])
    return prosim_scene.load(write_scene(text), target=target)


def translated(*arguments, **statements):
    """The BSDF of that SURFACE."""
    return loaded(*arguments, **statements)["surface_0"]["bsdf"]


def median_angle(bsdf):
    """The median angle to the mirror direction of rays that a rough BSDF reflects near the normal, in degrees."""
    ctx = mi.BSDFContext()
    ctx.type_mask = mi.BSDFFlags.GlossyReflection
    rng = mi.PCG32(size=100_000)
    si = dr.zeros(mi.SurfaceInteraction3f, 100_000)
    si.wi = mi.Vector3f(math.sin(0.1), 0, math.cos(0.1))
    sample = mi.load_dict(bsdf).sample(ctx, si, rng.next_float32(), mi.Point2f(rng.next_float32(), rng.next_float32()))
    cos = np.array(dr.dot(sample[0].wo, mi.reflect(si.wi)))[np.array(sample[0].pdf) > 0]
    return math.degrees(math.acos(np.median(cos)))


@pytest.mark.parametrize("target", ["prosim", "stock"])
@pytest.mark.parametrize(
    "roughness, cos_facet",  # the median facet, as the cosine of its angle to the normal
    [
        ("n = 100", math.cos(0.5 * math.acos(2 ** (-1 / 101)))),
        ("rug = 400", 2 ** (-1 / 402)),
        ("m = .07", math.cos(math.atan(0.07 * math.sqrt(math.log(2))))),
    ],
)
def test_roughness_has_one_meaning_for_all_materials(variant_rgb, write_scene, roughness, cos_facet, target):
    """Lobes of the same roughness are equally wide on all materials, to 3 %; before, some were twice as wide.

    The standard error of a median of 100,000 angles is below 0.5 %.
    """
    expected = 2 * math.degrees(math.acos(cos_facet))
    for material in MATERIALS.values():
        bsdf = translated(write_scene, f"{material} {roughness}", target)
        assert median_angle(bsdf) == pytest.approx(expected, rel=0.03), material


@pytest.mark.parametrize(
    "material, roughness, exponent",
    [
        *[("phong", "n = 1e6", 1e6), ("phong", "m = 1e-4", 1e6), ("phong", "m = 5", 0), ("phong", "rug = 0", 0)],
        *[("phong", "rug = 6", 1.5), ("phong", "m = 0", None), ("phong", "", None)],
        *[(m, f"n = {n}", min(4 * n, 1e6)) for m in ("conductor", "composite", "dielectric") for n in (0, 2.5e5, 1e6)],
    ],
)
def test_exponent_is_in_the_range_of_the_plugin(variant_rgb, write_scene, material, roughness, exponent):
    bsdf = translated(write_scene, f"{MATERIALS[material]} {roughness}")
    assert bsdf.get("exponent") == exponent and bsdf.get("distribution") == (None if material == "phong" else "phong")
    mi.load_dict(bsdf)


def test_composite_has_an_index_for_each_channel(write_scene, recwarn):
    """The stock target has one index, and says so."""
    surface = "material composite n-refr = 1.3 1.8 2.6 kd = 0"
    assert translated(write_scene, surface)["int_ior"] == {"type": "rgb", "value": [1.3, 1.8, 2.6]} and not recwarn
    with pytest.warns(prosim_scene.SceneWarning, match="n-refr differs between channels"):
        assert translated(write_scene, surface, "stock")["int_ior"] == pytest.approx((1.3 + 1.8 + 2.6) / 3)


BRIGHT = "TEXTURE t-a stripes color0 = 2 1 1 color1 = 0 0 0 "


@pytest.mark.parametrize(
    "variant, material, slots",
    [("llvm_ad_rgb", "material lambertian kd = .5", slots) for slots in ("t-a", "t-a t-a", "grey.png", "grey.png t-a")]
    + [
        ("llvm_ad_rgb", "kd = .5", ""),
        ("llvm_ad_spectral", "kd = .5", ""),
        ("llvm_ad_spectral", "kd = .5", "NULL t-a"),
    ],
)
def test_ka_above_1_keeps_its_light(variant, write_scene, tmp_path, material, slots):
    """ka = 3 is as bright as ka = 1 in three times the ambient light, with any textures; before, ka ended at 1."""
    mi.set_variant(variant)
    mi.Bitmap(np.full((4, 4, 3), 128, np.uint8)).write(str(tmp_path / "grey.png"))
    images = []
    for ka, ambient in (1, 19660.5), (3, 6553.5):
        text = f"AMBIENT {ambient} {ambient} {ambient} NSAMPLES 2 VIEW RESOLUTION 8 8 WINDOW -.4 -.4 .4 .4 EYE 0 0 9"
        text += f" {BRIGHT} CSG-TREE CUBE 0 {slots} SURFACE 0 {material} ka {ka} TRANSFORM 0 TRANSLATE (-.5 -.5 -1) END"
        path = prosim_scene.translate(write_scene(text))
        images.append(np.array(mi.render(mi.load_file(str(path), parallel=False), seed=1)))
    np.testing.assert_allclose(*images, rtol=2e-3)
    if not slots and variant == "llvm_ad_rgb":
        np.testing.assert_allclose(images[1], 0.3, rtol=1e-4)


@pytest.mark.parametrize("target", ["prosim", "stock"])
@pytest.mark.parametrize(
    "kd, slots, clipped",
    [(1, "t-a", True), (0.6, "NULL t-a", True), (0.4, "t-a t-a", True), (0.4, "NULL t-a", False), (1, "", False)],
)
def test_kd_above_1_is_clipped_with_a_warning(write_scene, recwarn, kd, slots, clipped, target):
    text = "TEXTURE t-a stripes color0 = 2 1 1 color1 = 2 1 1\nLIGHTS POINT position 0 0 9\n"
    text += f"CSG-TREE + CUBE 0 {slots} CUBE 0 {slots}\nSURFACE 0\n  kd = {kd}\nTRANSFORM 0 END"
    prosim_scene.load(write_scene(text), target=target)
    found = [str(one.message) for one in recwarn if "is clipped to 1" in str(one.message)]
    assert [":5:" in one and "kd times a texture is above 1" in one for one in found] == [True] * clipped


METHOD = {
    "adaptive graded": ("integrator", {"adaptive": "graded"}),
    "threshold .02": ("integrator", {"threshold": 0.02}),
    "cutoff .01": ("integrator", {"cutoff": 0.01}),
    "fresnel thesis": ("conductor", {"fresnel": "thesis"}),
    "facets gaussian": ("conductor composite dielectric", {"distribution": "gaussian"}),
    "multiple-scattering TRUE": ("conductor composite dielectric", {"multiple_scattering": True}),
    "phong literal": ("phong", {"normalized": False}),
}


@pytest.mark.slow
@pytest.mark.parametrize("words", METHOD)
def test_method_reaches_integrator_and_materials(variant_rgb, write_scene, recwarn, words):
    """Each word changes the plugins that it names, and no others; without METHOD nothing is said."""
    changed, parameters = METHOD[words]
    for statement in {}, {"METHOD": words}:
        nodes = {"integrator": loaded(write_scene, "kd = .1 ks = .5 n = 9", **statement)["integrator"]}
        nodes |= {name: translated(write_scene, f"{MATERIALS[name]} m = .4", **statement) for name in MATERIALS}
        for name, node in nodes.items():
            assert (parameters.items() <= node.items()) == bool(statement and name in changed.split())
            mi.load_dict(node)
    assert not recwarn
    with pytest.warns(prosim_scene.SceneWarning, match="METHOD has no effect"):
        translated(write_scene, "kd = .1", "stock", METHOD=words)


@pytest.mark.parametrize(
    "english, portuguese",
    [
        ("METHOD adaptive none threshold 1", "METODO limiar 1 adaptativo = nenhuma"),
        (
            "METHOD fresnel thesis facets gaussian cutoff .1 multiple-scattering TRUE",
            "método: fresnel tese facetas gaussiana corte .1 espalhamento-múltiplo SIM",
        ),
        ("METHOD", ""),
    ],
)
def test_method_has_words_in_english_and_portuguese(english, portuguese):
    scene, other = (prosim_scene.parse(f"{text} END", "s") for text in (english, portuguese))
    assert scene == other == prosim_scene.parse(prosim_scene.format(f"{english} END"), "s")
    assert (scene.method == prosim_scene.model.Method()) == (not portuguese)
