"""Long chains of + and -, which are evaluated in halves."""

import random

import exact_csg
import numpy as np
import pytest
from manifold3d import Manifold
from meshes import area, assert_closed, scene, solids, volume
from prosim_scene.solids import chains, parts
from test_exact_csg import EDGE, wrong_pixels


@pytest.mark.parametrize("kind", ["general", "grid", "nested", "grazing"])
def test_chains_in_halves_are_what_the_tree_means(variant_rgb, tmp_path, monkeypatch, kind):
    monkeypatch.setattr(chains, "DEEP", 0)
    assert wrong_pixels(exact_csg.KINDS[kind](np.random.default_rng([1, 7])), tmp_path) <= EDGE


def halved(monkeypatch, text):
    """The meshes of a scene and how many pairs of halves there were."""
    found = []
    original = chains.in_halves
    monkeypatch.setattr(chains, "DEEP", 0)
    monkeypatch.setattr(chains, "in_halves", lambda *a: found.append(a[2:]) or original(*a))
    return solids(text), len(found)


def test_a_comb_in_halves_is_the_comb_one_by_one(monkeypatch):
    # A bar with teeth, and gaps in these, all flush with its sides.
    rng = random.Random(3)
    transforms = ["SCALE (8 1 1) TRANSLATE (-4 0 0)"] + [
        f"SCALE ({rng.uniform(0.5, 1)} 1 {rng.uniform(1.5, 2)}) TRANSLATE ({0.3 * i - 3} 0 0)" for i in range(20)
    ]
    tree = " ".join(["-+"[i % 2] for i in range(20)]) + " " + " ".join(f"CUBE {i}" for i in range(21))
    text = scene(tree, transforms)
    meshes = list(solids(text).values())
    again, count = halved(monkeypatch, text)
    assert count > 1
    assert_closed(list(again.values()))
    assert volume(list(again.values())) == pytest.approx(volume(meshes), rel=1e-12)


@pytest.mark.filterwarnings("ignore:.*nothing is seen of CUBE 1")
def test_a_face_that_was_covered_and_is_laid_bare_again_is_the_cutters(monkeypatch):
    # CUBE 1 covers the top of CUBE 0; CUBE 2 takes it away down to just there.
    text = scene("- + CUBE 0 CUBE 1 CUBE 2", ["", "TRANSLATE (0 0 .5)", "SCALE (3 3 3) TRANSLATE (-1 -1 1)"])
    meshes, count = halved(monkeypatch, text)
    assert count == 0 and meshes.keys() == {0, 2}


def overlapping(count):
    """Boxes that all overlap at one point, added and taken away in turn, the first ones small."""
    rng = random.Random(5)
    transforms = [
        f"TRANSLATE (-.5 -.5 -.5) SCALE ({' '.join(str(rng.uniform(0.2, 0.3) + i / count) for _ in range(3))}) "
        f"ROTATE-X ({rng.uniform(0, 360)}) ROTATE-Z ({rng.uniform(0, 360)})"
        for i in range(count)
    ]
    tree = ["-+"[i % 2] for i in range(count - 1)]
    surfaces = [f"material lambertiano kd = 0.{100 + i} 0 0" for i in range(count)]
    return scene(" ".join([*tree, *(f"CUBE {i}" for i in range(count))]), transforms, surfaces)


@pytest.fixture
def gone(monkeypatch):
    """What is left out of each chain."""
    found = []
    original = chains.covered
    monkeypatch.setattr(chains, "covered", lambda *a: found.append(original(*a)) or found[-1])
    return found


@pytest.mark.filterwarnings("ignore:.*nothing is seen of")
def test_what_later_solids_cover_is_left_out_and_the_rest_is_the_same(monkeypatch, gone):
    text = overlapping(40)
    one_by_one = list(solids(text).values())
    assert not gone
    meshes, _ = halved(monkeypatch, text)
    assert 10 < gone[0].sum() < 40 and not gone[0][-1]
    assert_closed(list(meshes.values()))
    assert volume(list(meshes.values())) == pytest.approx(volume(one_by_one), rel=1e-9)
    assert not set(meshes) & set(np.flatnonzero(gone[0]).tolist())


@pytest.mark.filterwarnings("ignore:.*nothing is seen of")
@pytest.mark.parametrize("place, covered", [(0.5, False), (0.3, True)])
def test_what_touches_the_surface_of_what_covers_it_stays(monkeypatch, gone, place, covered):
    transforms = [f"SCALE (.5 .5 .5) TRANSLATE (.25 .25 {place})", "", "SCALE (.1 .1 2)"]
    meshes, _ = halved(monkeypatch, scene("- + CUBE 0 CUBE 1 CUBE 2", transforms))
    assert gone[0].tolist() == [covered, False, False] and (0 in meshes) != covered


@pytest.mark.parametrize(
    "sign, material, result",
    [("-", "", 64 * 0.75), ("+", "", 64 + 64 * 0.5), ("+", "material dieletrico n-refr = 1.5", None)],
)
def test_a_crowd_of_holes_and_of_pegs(monkeypatch, sign, material, result):
    # Holes through a plate, or pegs that stand out on both sides; those of glass give way to the plate, which bears
    # what they touch.
    transforms = ["SCALE (8 8 1)"] + [
        f"SCALE (.5 .5 3) TRANSLATE ({x + 0.25} {y + 0.25} -1)" for x in range(8) for y in range(8)
    ]
    surfaces = ["material condutor n-refr = 1.2 k-abs = 3"] + [material or "kd = .5"] * 64
    text = scene(" ".join([sign] * 64 + [f"CUBE {i}" for i in range(65)]), transforms, surfaces)
    plain = solids(text)
    divided = []
    monkeypatch.setattr(parts, "CROWD", 1)
    monkeypatch.setattr(parts, "FEW", 1)
    original = Manifold.refine_to_length
    monkeypatch.setattr(parts.Manifold, "refine_to_length", lambda *a: divided.append(a[1]) or original(*a))
    again = solids(text)
    assert divided
    assert {key: area(mesh) for key, mesh in again.items()} == pytest.approx({k: area(m) for k, m in plain.items()})
    if result:
        assert_closed(again.values())
        assert volume(list(again.values())) == pytest.approx(result, rel=1e-9)
