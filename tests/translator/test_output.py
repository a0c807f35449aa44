"""What is written: XML that Mitsuba loads without a warning, meshes, dictionaries, the stock target."""

import math
import subprocess
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np
import prosim_scene
import pytest

pytestmark = pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture
def everything(tmp_path, write_scene):
    """A scene with every kind of light, material and texture, and its image file."""
    mi.set_variant("llvm_ad_rgb")
    mi.Bitmap(np.full((4, 4, 3), 128, np.uint8)).write(str(tmp_path / "madeira.png"))
    return write_scene(Path(__file__).with_name("everything.scn").read_text(), "tudo.scn")


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
    for statement in ("VIEW (line 13)", "AREA (line 6)", "SURFACE 4 of CUBE 4"):
        assert f"<!-- {statement}" in text
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
    assert prosim_scene.load(path)["integrator"].get("caustics") == (asked or None)
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
    said = "1:44: a POINT light has a raio only with light units 'radiance'"
    assert any(said in str(w.message) for w in recwarn) == (units != "radiance")


@pytest.mark.slow
def test_both_targets_are_comparably_bright(variant_rgb):
    means = []
    for target in ("prosim", "stock"):
        scene = mi.load_dict(prosim_scene.load(EXAMPLES / "palito.scn", target=target, resolution=(64, 64)))
        means.append(np.array(mi.render(scene, spp=64)).mean(axis=(0, 1)))
    assert np.allclose(means[0], means[1], rtol=0.25)
