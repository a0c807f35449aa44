"""What is written: XML that Mitsuba loads without a warning, meshes, dictionaries, the stock target."""

import math
import subprocess
import sys
import warnings
from pathlib import Path

import mitsuba as mi
import numpy as np
import prosim_scene
import pytest

pytestmark = pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")

EXAMPLES = Path(__file__).parents[2] / "examples"

EVERYTHING = """
NAME: tudo  SAVE-RGB: TRUE TRUE FALSE  MAX-LEVEL: 2  NSAMPLES: 2  DO-SHADOW: FALSE  AIR-INDEX: 1.1
AMBIENT 10000 10000 20000
METHOD adaptive graded threshold .01 cutoff .001 fresnel thesis facets gaussian phong literal multiple-scattering TRUE
LIGHTS
    AREA position 3 9 5 Intensity 90000 80000 70000 raio .5
    AREA position -3 9 5 Intensity 90000 80000 70000 raio .5 CONE direction 0 -1 0 angle 40
    AREA position -3 9 5 raio .2 SPOT direction 0 -1 -.2 exponent 20 angle 60
    POINT position 0 9 5 Intensity 90000 80000 70000
    POINT position 1 9 5 Intensity 9000 8000 7000 CONE direction 0 -1 0 angle 20
    POINT position 2 9 5 Intensity 9000 8000 7000 SPOT direction 0 -1 0
BACKGROUND: 100 200 300 NULL
VIEW RESOLUTION 40 40 WINDOW -4 -4 4 4 OBS 0 2 12 VRP 0 0 0 VUP 0 1 0
CSG-TREE + + + + + + + CUBE 0 t-tijolo t-fractal SPHERE 1 CYLINDER 2 t-listra CONE 3 NULL t-veios CUBE 4 SPHERE 5
    CUBE 6 madeira.png SPHERE 7
SURFACE 0 material composto n-refr = 1.5 kd = .5 .4 .3 rug = 20
SURFACE 1 material condutor ouro m = .2
SURFACE 2 material lambertiano kd = .5 .2 .1 ka = .1 .1 .1
SURFACE 3 ka = .1 .2 .3 kd = .3 .3 .3 ks = .3 .2 .2
SURFACE 4 ka = .1 .2 .3 kd = .3 .3 .3 ks = .3 .2 .2 n = 12
SURFACE 5 material dieletrico n-refr = 1.5
SURFACE 6 material lambertiano kd = .9 .8 .7
SURFACE 7 material dieletrico n-refr = 1.6 1.62 1.64 m = .1
TEXTURE t-veios fractal color0 = 1 1 1 color1 = .3 .2 .1 scale = 3
TRANSFORM 0 SCALE (8 .1 8) TRANSLATE (-4 -2 -4)
TRANSFORM 1 TRANSLATE (-2 0 0)
TRANSFORM 2 ROTATE-X (-90) TRANSLATE (0 -1.9 0)
TRANSFORM 3 ROTATE-X (90) TRANSLATE (0 1 0)
TRANSFORM 4 TRANSLATE (1.2 -1.9 0)
TRANSFORM 5 SCALE (.5 .5 .5) TRANSLATE (2.6 0 1)
TRANSFORM 6 TRANSLATE (1.2 -.8 0)
TRANSFORM 7 SCALE (.5 .5 .5) TRANSLATE (-1 0 3)
END
"""


@pytest.fixture
def everything(tmp_path, write_scene):
    """A scene with every kind of light, material and texture, and its image file."""
    mi.set_variant("llvm_ad_rgb")
    mi.Bitmap(np.full((4, 4, 3), 128, np.uint8)).write(str(tmp_path / "madeira.png"))
    return write_scene(EVERYTHING, "tudo.scn")


@pytest.fixture
def silent(variant_rgb):
    """What Mitsuba warns of is an error."""
    logger = mi.logger()
    level = logger.error_level()
    logger.set_error_level(mi.LogLevel.Warn)
    yield
    logger.set_error_level(level)


@pytest.mark.parametrize("target, units", [("prosim", "calibrated"), ("stock", "radiance")])
def test_mitsuba_loads_the_xml_and_the_same_dictionary_without_a_warning(silent, everything, target, units, tmp_path):
    how = {"target": target, "light_units": units, "tolerance": 0.5}
    path = prosim_scene.translate(everything, tmp_path / "out", **how)
    scene = mi.load_file(str(path), parallel=False)
    assert len(scene.shapes()) == (11 if target == "prosim" else 9)  # stock cone and spot lights are points
    assert tuple(scene.sensors()[0].film().size()) == (40, 40)
    written, loaded = mi.traverse(scene), mi.traverse(mi.load_dict(prosim_scene.load(everything, **how)))
    assert sorted(dict(written.items())) == sorted(dict(loaded.items()))
    for key, value in written.items():
        if "Transform" not in type(value).__name__:
            assert np.allclose(np.array(value), np.array(loaded[key]), rtol=1e-5, atol=1e-6), key
    text = path.read_text()
    assert ("prosim" in text or "nrook" in text) == (target == "prosim")
    path = (tmp_path / "out").rename(tmp_path / "moved") / path.name  # all paths are relative
    assert "../madeira.png" in text
    scene = mi.load_file(str(path), parallel=False, width="20", height="20")
    assert tuple(scene.sensors()[0].film().size()) == (20, 20)


@pytest.mark.slow
@pytest.mark.parametrize("target", ["prosim", "stock"])
def test_image_of_all_words_is_finite(silent, everything, target):
    image = np.array(mi.render(mi.load_dict(prosim_scene.load(everything, target=target, tolerance=0.5)), spp=4))
    assert np.isfinite(image).all() and image.max() > 0


def test_the_translator_never_imports_mitsuba():
    code = (
        "import sys, warnings; warnings.simplefilter('ignore'); import prosim_scene\n"
        f"prosim_scene.load({str(EXAMPLES / 'palito.scn')!r})\n"
        "assert not {'mitsuba', 'drjit', 'mitsuba_prosim'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_palito(tmp_path, silent):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        path = prosim_scene.translate(EXAMPLES / "palito.scn", tmp_path)
    scene = mi.load_file(str(path), parallel=False)
    shapes = {s.id(): s for s in scene.shapes()}
    assert sorted(shapes) == ["light_0"] + [f"surface_{i}" for i in range(5)]
    text = path.read_text()
    for statement in ("VIEW (line 17)", "AREA (line 10)", "SURFACE 4 of SPHERE 4"):
        assert f"<!-- {statement}" in text
    # E = Intensity / 65535 on a facing surface at VRP: L = E d^2 / (pi r^2)
    d2 = 20**2 + 12**2 + 20**2
    light = shapes["light_0"].emitter()
    radiance = np.array(mi.traverse(light)["radiance.value"]).ravel()
    assert radiance == pytest.approx(3 * [400000 / 65535 * d2 / (math.pi * 1.8**2)], rel=1e-5)


def test_an_image_on_another_drive_is_named_in_full(everything, tmp_path, monkeypatch):
    """Windows knows no way from one drive to another."""

    def no_way(*_):
        raise ValueError("path is on mount 'C:', start on mount 'D:'")

    monkeypatch.setattr("os.path.relpath", no_way)
    text = prosim_scene.translate(everything, tmp_path / "out").read_text()
    assert f'value="{everything.parent.as_posix()}/' in text


def test_check_reports_each_approximation_once(everything, recwarn):
    before = sorted(everything.parent.rglob("*"))
    assert prosim_scene.check(everything, target="stock", tolerance=1).name == "tudo"
    assert sorted(everything.parent.rglob("*")) == before
    said = [str(w.message).partition("stock target: ")[2].partition("\n")[0] for w in recwarn]
    said = [words for words in said if words]
    assert len(said) == len(set(said)) > 8


@pytest.mark.parametrize("said, asked", [("", False), ("CAUSTICS FALSE", False), ("CÁUSTICAS: SIM", True)])
def test_caustics_statement_reaches_the_integrator(said, asked, write_scene, recwarn):
    text = f"{said} LIGHTS POINT position 0 5 5 CSG-TREE SPHERE 0 SURFACE 0 material dieletrico bk7 TRANSFORM 0 END"
    path = write_scene(text)
    assert prosim_scene.parse(text).caustics is prosim_scene.parse(prosim_scene.format(text)).caustics is asked
    assert prosim_scene.load(path, transform=list)["integrator"].get("caustics") == (asked or None)
    xml = prosim_scene.translate(path).read_text()
    assert ('<boolean name="caustics" value="true"/>' in xml) is ("DO-SHADOW, CAUSTICS, AMBIENT" in xml) is asked
    assert ("caustics" in xml) is ("CAUSTICS" in xml) is asked
    stock = prosim_scene.translate(path, target="stock").read_text()
    left = [w for w in recwarn if "has no effect; 'path' finds caustics by chance" in str(w.message)]
    assert len(left) == asked and "caustics" not in stock


@pytest.mark.slow
@pytest.mark.parametrize(
    "light, irradiance",
    [
        ("AREA raio .1 angle 1", {"calibrated": 1, "unattenuated": 1, "radiance": math.pi * 0.1**2 / 4**2}),
        ("AREA raio 1 SPOT direction 0 0 -1 exponent 40", 1),
        ("AREA raio 2 SPOT direction 0 0 -1 exponent 3 angle 20", 1),
        ("AREA raio 2 CONE direction 0 0 -1 angle 15", 1),
        ("POINT SPOT direction 0 0 -1 exponent 9", 1),
        # VRP lies beside the axis: what counts is a surface as far away, on the axis.
        ("POINT SPOT direction 0 .6 -.8 exponent 2", 0.64),
        ("POINT CONE direction 0 .6 -.8 angle 20", 0),
    ],
)
def test_calibrated_lights_give_their_irradiance_at_vrp(light, irradiance, write_scene, variant_rgb):
    """A lambertian wall that faces the light at VRP, 4 away: the mean over a tiny window."""
    kind, *rest = light.split(maxsplit=1)
    path = write_scene(
        "VIEW RESOLUTION 8 8 WINDOW -.01 -.01 .01 .01 OBS 0 0 1 VRP 0 0 0 NSAMPLES 16\n"
        f"LIGHTS {kind} position 0 0 4 {rest[0]}\n"
        "CSG-TREE CUBE 0 SURFACE 0 material lambertiano kd = 1 1 1 ka = 0 0 0\n"
        "TRANSFORM 0 SCALE (4 4 1) TRANSLATE (-2 -2 -1) END"
    )
    for units, expected in (irradiance if isinstance(irradiance, dict) else {"calibrated": irradiance}).items():
        image = mi.render(mi.load_dict(prosim_scene.load(path, light_units=units)), seed=1)
        assert np.array(image).mean() * math.pi == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("target", ["prosim", "stock"])
@pytest.mark.parametrize("units", ["calibrated", "unattenuated", "radiance"])
def test_a_radius_without_effect_is_a_warning(write_scene, recwarn, units, target):
    path = write_scene("VIEW OBS 0 0 9 LIGHTS POINT position 0 0 5 raio 2 CSG-TREE CUBE 0 SURFACE 0 TRANSFORM 0 END")
    prosim_scene.check(path, light_units=units, target=target)
    said = "1:44: raio has an effect on a POINT light only with light units 'radiance'"
    assert any(said in str(w.message) for w in recwarn) == (units != "radiance")


@pytest.mark.slow
def test_both_targets_are_comparably_bright(variant_rgb):
    means = []
    for target in ("prosim", "stock"):
        scene = mi.load_dict(prosim_scene.load(EXAMPLES / "palito.scn", target=target, resolution=(64, 64)))
        means.append(np.array(mi.render(scene, spp=64)).mean(axis=(0, 1)))
    assert np.allclose(means[0], means[1], rtol=0.25)
