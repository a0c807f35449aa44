"""The examples of docs/extending.md work."""

import dataclasses
import re
import types
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import prosim_scene
import pytest
from image_statistics import renderings, same_expectation
from mitsuba_prosim import check, registry
from mitsuba_prosim.engine.policies import POLICIES
from mitsuba_prosim.light import table
from mitsuba_prosim.light.table import Lights
from prosim_scene.language import words
from prosim_scene.model import Scene
from scenes import area, camera, film, ground

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "docs" / "extending.md").read_text("utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)


def module(package, first):
    """The module of the block whose docstring begins with ``first``, as if it lay in ``package``."""
    (text,) = [block for block in BLOCKS if block.startswith(f'"""{first}')]
    made = types.ModuleType(f"{package}.example")
    made.__package__ = package
    exec(compile(text, made.__name__, "exec", dont_inherit=True), made.__dict__)
    return made


@pytest.mark.slow
def test_bsdf(variant_rgb, monkeypatch):
    monkeypatch.setattr(registry, "PLUGINS", {})
    module("mitsuba_prosim.bsdfs", "Dusty")
    assert list(registry.PLUGINS) == ["prosim_lunar"]
    check.check({"type": "prosim_lunar", "albedo": 0.8}).raise_if_wrong()


@pytest.mark.parametrize("albedo, expected", [(0.8, 0.1), (0.0, 0.0)])
def test_bsdf_has_a_default_albedo(variant_rgb, monkeypatch, albedo, expected):
    """pi times the BRDF along the normal, whatever the direction of the viewer; the denoiser's layer shows it."""
    monkeypatch.setattr(registry, "PLUGINS", {})
    module("mitsuba_prosim.bsdfs", "Dusty")
    dusty = {"type": "prosim_lunar", "albedo": albedo}
    si = dr.zeros(mi.SurfaceInteraction3f, 3)
    si.wi = dr.normalize(mi.Vector3f([0, 0.6, 0.99], 0, [1, 0.7, 0.1]))
    for bsdf in (dusty, {"type": "twosided", "b": dusty}):
        assert np.allclose(np.array(mi.load_dict(bsdf).eval_diffuse_reflectance(si)), expected, atol=1e-6)
    sensor = camera([0, 1, 0], [0, 0, 0], film(4), (0, 0, 1), fov=60)
    layers = {"type": "aov", "aovs": "albedo:albedo"}
    scene = mi.load_dict({"type": "scene", "sensor": sensor, "floor": ground(4, dusty), "integrator": layers})
    assert np.allclose(np.array(mi.render(scene, spp=4))[..., -3:], expected, atol=1e-5)


def under_tubes(count, floor, **integrator):
    """A floor below as many tubes; the camera sees the floor alone."""
    tubes = {}
    for i in range(count):
        ends = {"p0": [0.7 * i - 2, 1, -1], "p1": [1 - 0.4 * i, 1.1 + 0.4 * i, 1]}
        tubes[f"tube_{i}"] = {"type": "cylinder", "radius": 0.1 + 0.05 * i, **ends, **area(1.0 + i)}
    sensor = camera([0, 0.5, 0], [0, 0, 0], film(8), (0, 0, 1), fov=90)
    return tubes | {"type": "scene", "integrator": integrator, "sensor": sensor, "floor": ground(4, floor)}


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, Lights.UNROLLED + 1])
def test_light(variant_rgb, count, monkeypatch):
    """The expectation of Mitsuba's own sampling, on a rough mirror too; with less variance."""
    settings = {"type": "prosim", "adaptive": "none", "max_level": 0}
    floors = {"type": "diffuse"}, {"type": "roughconductor", "alpha": 0.4}
    direct = [renderings(under_tubes(count, floor, type="direct"), 12, spp=64) for floor in floors]
    without = renderings(under_tubes(count, floors[0], **settings), 12, spp=16)
    tubes = module("mitsuba_prosim.light", "Tubes").TubeLights
    monkeypatch.setattr(table, "STRATEGIES", (tubes, *table.STRATEGIES))
    ours = [renderings(under_tubes(count, floor, **settings), 12, spp=16) for floor in floors]
    assert all(map(same_expectation, direct, ours))
    assert ours[0].var(0).mean() < 0.4 * without.var(0).mean()


LAMPS = {
    "tube": ({"type": "cylinder", **area(1.0)}, True),
    "tube that emits inwards": ({"type": "cylinder", "flip_normals": True, **area(1.0)}, False),
    "tube with a texture": ({"type": "cylinder", **area({"type": "checkerboard"})}, False),
    "tube that emits along its normals": ({"type": "cylinder", "lamp": {"type": "directionalarea"}}, False),
    "ball": ({"type": "sphere", **area(1.0)}, False),
    "rectangle": ({"type": "rectangle", **area(1.0)}, False),
    "point": ({"type": "point"}, False),
    "sky": ({"type": "constant"}, False),
}


@pytest.mark.parametrize("name", LAMPS)
def test_strategy_samples_tubes_only(variant_rgb, monkeypatch, name):
    """Other lamps keep the strategies that they have."""
    lamp, is_tube = LAMPS[name]
    scene = mi.load_dict({"type": "scene", "lamp": lamp})
    before = [type(strategy) for strategy, *_ in Lights(scene).groups]
    tubes = module("mitsuba_prosim.light", "Tubes").TubeLights
    monkeypatch.setattr(table, "STRATEGIES", (tubes, *table.STRATEGIES))
    after = [type(strategy) for strategy, *_ in Lights(scene).groups]
    assert after == ([tubes] if is_tube else before)


def test_statement_is_read_with_the_default_of_the_integrator(variant_rgb):
    """The row of words.txt is well formed, and the field of the model has the default that its meaning says."""
    text = TEXT.partition("## Add a statement")[2].partition("\n## ")[0]
    row, field, parameter = re.findall(r"```(?:python)?\n(.*?)```", text, re.DOTALL)
    cells, _, meaning = row.partition("\n")
    role, _, name, numbers = map(str.strip, cells.split("|"))
    assert role in words.ROLES and all(not words.WORDS_BY_SPELLING.get(s.lower()) for s in cells.split() if "-" in s)
    default = re.search(rf"{name}: \w+ = (\S+)", field)[1]
    assert f"Default: {default}." in meaning and numbers.startswith("1 ")
    assert float(default) == getattr(mi.load_dict({"type": "prosim"}), name)
    assert parameter.strip() == f'"{name}": scene.{name},' and name not in {f.name for f in dataclasses.fields(Scene)}


@pytest.mark.slow
def test_policy(variant_rgb, monkeypatch):
    monkeypatch.setitem(POLICIES, "contrast", module("mitsuba_prosim.engine", "All samples where").Contrast)
    scene = prosim_scene.load(ROOT / "examples" / "poste.scn", resolution=(60, 45), samples=3)

    def counts(**integrator):
        scene["integrator"] |= {"adaptive": "contrast", "threshold": 0.1, "aovs": "samples", **integrator}
        return np.array(mi.render(mi.load_dict(scene)))[..., -1]

    whole = counts()
    assert set(np.unique(whole)) == {3, 9} and 0.05 < np.mean(whole == 9) < 0.95
    assert np.array_equal(counts(band=700), whole)


def test_primitive():
    wedge = module("prosim_scene.geometry", "WEDGE").Wedge()
    mesh = wedge.mesh(wedge.segments(np.eye(4), None, 0.1), np.eye(4))
    assert len(mesh.triangles) == 8
    edges = np.concatenate([mesh.triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    assert sorted(map(tuple, edges)) == sorted(map(tuple, edges[:, ::-1]))  # closed, all wound one way
    corners = mesh.vertices[mesh.triangles]
    assert np.linalg.det(corners).sum() / 6 == pytest.approx(0.5)  # seen from outside
    face = mesh.faces[mesh.facets]
    p = np.append(corners, np.ones((8, 3, 1)), axis=2)
    assert np.allclose(np.einsum("tki,tij,tkj->tk", p, wedge.quadrics[face], p), 0)  # on the surfaces that it names
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.all(np.einsum("ti,tki->tk", normals, wedge.corner_attributes(corners, face).normals) > 0)
