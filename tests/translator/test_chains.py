"""Long chains of + and -, which are evaluated in halves."""

import random

import exact_csg
import numpy as np
import pytest
from meshes import assert_closed, scene, solids, volume
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
@pytest.mark.parametrize("place, covered", [(0.5, False), (0.4, True)])
def test_what_touches_the_surface_of_what_covers_it_stays(monkeypatch, gone, place, covered):
    transforms = [f"SCALE (.5 .5 .5) TRANSLATE (.25 .25 {place})", "", "SCALE (.1 .1 9)"]
    meshes, _ = halved(monkeypatch, scene("- + CUBE 0 CUBE 1 CUBE 2", transforms))
    assert gone[0].tolist() == [covered, False, False] and (0 in meshes) != covered


def test_many_holes_are_made_a_few_at_first_and_are_all_there(monkeypatch):
    transforms = ["SCALE (8 8 1)"] + [
        f"SCALE (.5 .5 3) TRANSLATE ({x + 0.25} {y + 0.25} -1)" for x in range(8) for y in range(8)
    ]
    text = scene(" ".join(["-"] * 64 + [f"CUBE {i}" for i in range(65)]), transforms)
    for batch, counts in ((64, [64]), (4, [4, 12, 48])):
        monkeypatch.setattr(parts, "BATCH", batch)
        assert [len(some) for some in parts.batches(list(range(64)))] == counts
        meshes = list(solids(text).values())
        assert_closed(meshes)
        assert volume(meshes) == pytest.approx(64 * 0.75, rel=1e-9)
