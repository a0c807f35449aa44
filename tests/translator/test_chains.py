"""Long chains of + and -, which are evaluated in halves."""

import weakref

import exact_csg
import numpy as np
import pytest
from manifold3d import Manifold
from meshes import area, assert_closed, scene, solids, volume
from prosim_scene.geometry import csg
from test_exact_csg import EDGE, wrong_pixels


@pytest.mark.parametrize("kind", ["general", "grid", "chains", "nested", "grazing"])
def test_chains_in_halves_are_what_the_tree_means(variant_rgb, tmp_path, monkeypatch, kind):
    monkeypatch.setattr(csg, "MAX_BATCH", 1)
    assert wrong_pixels(exact_csg.KINDS[kind](np.random.default_rng([1, 7])), tmp_path) <= EDGE


@pytest.mark.filterwarnings("ignore:.*nothing is visible of CUBE 1")
def test_a_face_that_was_covered_and_is_laid_bare_again_is_the_cutters():
    # CUBE 1 covers the top of CUBE 0; CUBE 2 takes it away down to just there.
    text = scene("- + CUBE 0 CUBE 1 CUBE 2", ["", "TRANSLATE (0 0 .5)", "SCALE (3 3 3) TRANSLATE (-1 -1 1)"])
    assert solids(text).keys() == {0, 2}


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
    monkeypatch.setattr(csg, "MAX_BATCH", 8)
    monkeypatch.setattr(csg, "MAX_NEIGHBOURS", 1)
    monkeypatch.setattr(csg, "REFINED_NEIGHBOURS", 1)
    again = solids(text)
    assert {key: area(mesh) for key, mesh in again.items()} == pytest.approx({k: area(m) for k, m in plain.items()})
    if result:
        assert_closed(again.values())
        assert volume(list(again.values())) == pytest.approx(result, rel=1e-9)


def test_a_union_does_not_keep_its_operands():
    bodies = [csg.Body(Manifold.cube, np.zeros((1, 2, 3)), frozenset(), None) for _ in range(3)]
    operands, joined = [weakref.ref(body) for body in bodies], csg.union(bodies)
    bodies.clear()
    assert joined.manifold() is joined.manifold()
    assert [body() for body in operands] == [None] * 3
