"""Faces that coincide but for rounding: no film of no thickness, no face of the wrong primitive, a closed surface."""

import math
import re

import exact_csg
import numpy as np
import pytest
from meshes import area, assert_closed, scene, solids, volume
from prosim_scene import SceneWarning
from prosim_scene.geometry.coincidence import same_surfaces
from prosim_scene.language import document_of

GLASS = "material dieletrico n-refr = 1.5"


def turns(count, seed=1):
    """Steps of random rotations with a move."""
    rng = np.random.default_rng(seed)
    for x, y, z in rng.uniform(-180, 180, (count, 3)):
        yield f"ROTATE-X ({x}) ROTATE-Y ({y}) ROTATE-Z ({z}) TRANSLATE ({x / 90} {y / 90} {z / 90})"


def test_a_flush_cut_in_a_turned_block_is_open():
    for turn in turns(60):
        meshes = solids(scene("- CUBE 0 CUBE 1", [turn, f"SCALE (.5 .5 .5) TRANSLATE (.25 .25 .5) {turn}"]))
        assert_closed(meshes.values())
        assert area(meshes[0]) == pytest.approx(6 - 0.25, abs=1e-6), turn
        assert area(meshes[1]) == pytest.approx(5 * 0.25, abs=1e-6), turn


def test_a_flush_cut_at_a_decimal_height_is_open():
    for tenths in range(2, 60):
        height = tenths / 10
        meshes = solids(
            scene(
                "- CUBE 0 CUBE 1",
                [f"SCALE (1 1 {height})", f"SCALE (.5 .5 .1) TRANSLATE (.25 .25 {round(height - 0.1, 1)})"],
            )
        )
        assert area(meshes[0]) == pytest.approx(2 + 4 * height - 0.25, abs=1e-6), height
        assert area(meshes[1]) == pytest.approx(0.25 + 4 * 0.05, abs=1e-6), height


@pytest.mark.parametrize("surfaces", [(), (GLASS, GLASS)])
def test_touching_blocks_have_no_wall_between_them(surfaces):
    for turn in turns(40, seed=2):
        meshes = list(solids(scene("+ CUBE 0 CUBE 1", [turn, f"TRANSLATE (1 0 0) {turn}"], surfaces)).values())
        assert_closed(meshes)
        assert sum(map(area, meshes)) == pytest.approx(10, abs=1e-6), turn


def test_touching_blocks_of_two_glasses_have_one_interface():
    surfaces = [GLASS, "material dieletrico n-refr = 1.33"]
    for turn in turns(30, seed=3):
        meshes = solids(scene("+ CUBE 0 CUBE 1", [turn, f"TRANSLATE (1 0 0) {turn}"], surfaces))
        areas = {key: area(mesh) for key, mesh in meshes.items()}
        assert areas == {0: pytest.approx(5), 1: pytest.approx(5), (0, 1): pytest.approx(1)}, turn


def test_blocks_that_touch_along_an_edge_stay_closed():
    for turn in turns(20, seed=4):
        meshes = list(solids(scene("+ CUBE 0 CUBE 1", [turn, f"TRANSLATE (1 0 1) {turn}"])).values())
        assert_closed(meshes)
        assert volume(meshes) == pytest.approx(2) and sum(map(area, meshes)) == pytest.approx(12, abs=1e-6)


def test_a_band_on_a_pole_of_its_own_width_hides_the_pole():
    for turn in turns(8, seed=5):
        meshes = solids(
            scene(
                "+ CYLINDER 0 CYLINDER 1",
                [f"ROTATE-Z (17) SCALE (1 1 2) TRANSLATE (0 0 4) {turn}", f"SCALE (1 1 10) {turn}"],
            )
        )
        assert_closed(meshes.values())
        assert area(meshes[0]) == pytest.approx(2 * math.pi * 2, rel=2e-3)
        assert area(meshes[1]) == pytest.approx(2 * math.pi * 8 + 2 * math.pi, rel=2e-3)


def test_a_pole_less_a_shorter_one_is_the_rest():
    for turn in turns(8, seed=6):
        meshes = solids(
            scene("- CYLINDER 0 CYLINDER 1", [f"SCALE (1 1 10) {turn}", f"SCALE (1 -1 5) ROTATE-Z (31) {turn}"])
        )
        assert_closed(meshes.values())
        assert volume(list(meshes.values())) == pytest.approx(5 * math.pi, rel=3e-3)
        assert area(meshes[1]) == pytest.approx(math.pi, rel=2e-3)  # its disc; nothing of its side
        assert area(meshes[0]) == pytest.approx(math.pi + 2 * math.pi * 5, rel=2e-3)


def test_a_cone_less_its_tip_is_a_frustum():
    for turn in turns(8, seed=7):
        meshes = solids(scene("- CONE 0 CONE 1", [f"SCALE (2 2 2) {turn}", f"ROTATE-Z (50) {turn}"]))
        assert_closed(meshes.values())
        assert volume(list(meshes.values())) == pytest.approx(math.pi * 7 / 3, rel=3e-3)
        assert area(meshes[1]) == pytest.approx(math.pi, rel=2e-3)


@pytest.mark.slow
def test_a_ball_less_itself_is_nothing_however_it_is_turned():
    for turn in turns(5, seed=8):
        with pytest.warns(SceneWarning, match="the tree's result is empty"):
            assert (
                solids(scene("- SPHERE 0 SPHERE 1", ["SCALE (1 2 3)", f"{turn.split('TRANSLATE')[0]} SCALE (1 2 3)"]))
                == {}
            )


@pytest.mark.filterwarnings("ignore:.*nothing is seen of CUBE 2")
def test_two_halves_of_one_ball():
    # The same ball twice, turned, cut in halves by the same block from both sides: together the ball again.
    for turn in turns(5, seed=9):
        half = "SCALE (4 4 2) TRANSLATE (-2 -2 0)"
        meshes = solids(
            scene(
                "+ * SPHERE 0 CUBE 2 - SPHERE 1 CUBE 2",
                [turn.replace("TRANSLATE", "ROTATE-X (9) TRANSLATE"), turn, f"{half} {turn}"],
            )
        )
        assert set(meshes) == {0, 1}
        assert area(meshes[0]) == pytest.approx(2 * math.pi, rel=4e-3)
        assert area(meshes[1]) == pytest.approx(2 * math.pi, rel=4e-3)
        assert volume(list(meshes.values())) == pytest.approx(math.pi * 4 / 3, rel=4e-3)


def test_a_ball_in_a_pipe_of_its_own_width_does_not_show_through():
    # Their facets would cross along the circle in which they touch.
    for turn in turns(5, seed=10):
        with pytest.warns(SceneWarning, match="nothing is seen of SPHERE 1"):
            solids(
                scene("+ CYLINDER 0 SPHERE 1", [f"SCALE (1 1 4) TRANSLATE (0 0 -2) {turn}", f"ROTATE-Y (40) {turn}"])
            )


def test_what_is_the_same_but_for_rounding_is_recognised_and_nothing_else():
    quadrics = np.array([np.diag([1.0, 1, 1, -1])] * 4)
    matrices = np.array([np.eye(4)] * 4)
    matrices[1, 0, 3] = 1e-12
    matrices[2, :3, :3] *= 1 + 1e-5
    matrices[3, :3, :3] *= -1
    first, moved, _, mirrored = same_surfaces(quadrics, matrices)
    assert first == moved == mirrored
    assert same_surfaces(quadrics, matrices)[2] == 2
    small = matrices.copy()  # of balls a millionth the size of the scene as well
    small[:3, :3, :3] *= 1e-6
    small[:3, 0, 3] = [5, 5 + 1e-15, 5]
    found = same_surfaces(quadrics, small)
    assert found[0] == found[1] and found[2] == 2 and found[3] == 3


def crossings(meshes, origins, directions):
    """How often rays meet the meshes' triangles (Moeller and Trumbore 1997)."""
    p = np.concatenate([mesh.positions for mesh in meshes])
    a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    count = []
    for o, d in zip(origins, directions):
        h, s = np.cross(d, b), o - p[:, 0]
        det = np.einsum("ti,ti->t", a, h)
        det = np.where(np.abs(det) > 1e-12, det, np.inf)
        q = np.cross(s, a)
        u, v = np.einsum("ti,ti->t", s, h) / det, q @ d / det
        t = np.einsum("ti,ti->t", b, q) / det
        count.append(np.sum((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & np.isfinite(det)))
    return np.array(count)


@pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")
@pytest.mark.parametrize("turned", [False, True])
def test_light_crosses_every_interface_of_a_glass_once(turned):
    # Blocks of one glass on a grid: walls within the glass, or missing ones, would be more or fewer crossings.
    for seed in range(25):
        rng = np.random.default_rng([seed, turned])
        text = exact_csg.blocks(rng, exact_csg.turn(rng) if turned else "")
        text = re.sub(r"lambertiano kd \S+", "dieletrico n-refr 1.5", text)
        origins = np.full((200, 3), 9.0) * rng.choice([-1, 1], (200, 3))
        directions = rng.uniform(-2, 2, (200, 3)) - origins
        meshes = list(solids(text).values())
        found = crossings(meshes, origins, directions) if meshes else np.zeros(200, int)
        expected = exact_csg.crossings(document_of(text).scene, origins, directions)
        assert np.array_equal(found, expected), seed
