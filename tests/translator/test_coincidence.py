"""Faces that coincide but for rounding: no film of no thickness, no face of the wrong primitive, a closed surface."""

import math
import re

import numpy as np
import pytest
from meshes import area, assert_closed, scene, solids, volume
from prosim_scene import SceneWarning
from prosim_scene.geometry.coincidence import same_surfaces

GLASS = "material dieletrico n-refr = 1.5"
BESIDE = ["", "TRANSLATE (1 0 0)"]


def turns(count, seed=1):
    """Steps of random rotations with a move."""
    rng = np.random.default_rng(seed)
    for x, y, z in rng.uniform(-180, 180, (count, 3)):
        yield f"ROTATE-X ({x}) ROTATE-Y ({y}) ROTATE-Z ({z}) TRANSLATE ({x / 90} {y / 90} {z / 90})"


#: Name -> tree, transforms (then comes a random turn), materials, the areas of the meshes, their volume, and the turns.
TURNED = {
    "a flush cut is open": (
        "- CUBE 0 CUBE 1",
        ["", "SCALE (.5 .5 .5) TRANSLATE (.25 .25 .5)"],
        (),
        {0: 6 - 0.25, 1: 5 * 0.25},
        1 - 0.125,
        60,
    ),
    "touching blocks have no wall": ("+ CUBE 0 CUBE 1", BESIDE, (), {0: 5, 1: 5}, 2, 40),
    "nor those of one glass": ("+ CUBE 0 CUBE 1", BESIDE, (GLASS, GLASS), {0: 10}, 2, 40),
    "two glasses have one interface": (
        "+ CUBE 0 CUBE 1",
        BESIDE,
        (GLASS, "material dieletrico n-refr = 1.33"),
        {0: 5, 1: 5, (0, 1): 1},
        None,
        30,
    ),
    "blocks that touch along an edge": ("+ CUBE 0 CUBE 1", ["", "TRANSLATE (1 0 1)"], (), {0: 6, 1: 6}, 2, 20),
    "a band on a pole of its own width hides the pole": (
        "+ CYLINDER 0 CYLINDER 1",
        ["ROTATE-Z (17) SCALE (1 1 2) TRANSLATE (0 0 4)", "SCALE (1 1 10)"],
        (),
        {0: 4 * math.pi, 1: 18 * math.pi},
        10 * math.pi,
        8,
    ),
    "a pole less a shorter one": (
        "- CYLINDER 0 CYLINDER 1",
        ["SCALE (1 1 10)", "SCALE (1 -1 5) ROTATE-Z (31)"],
        (),
        {0: 11 * math.pi, 1: math.pi},  # of the shorter one there is the disc, and nothing of its side
        5 * math.pi,
        8,
    ),
    "a cone less its tip": (
        "- CONE 0 CONE 1",
        ["SCALE (2 2 2)", "ROTATE-Z (50)"],
        (),
        {0: (4 + 3 * 2**0.5) * math.pi, 1: math.pi},
        7 / 3 * math.pi,
        8,
    ),
}


@pytest.mark.parametrize("name", TURNED)
def test_coincident_faces_of_turned_solids(name):
    tree, transforms, surfaces, areas, expected, count = TURNED[name]
    near = {"rel": 3e-3} if "C" in re.sub("CUBE", "", tree) else {"abs": 1e-6}
    for turn in turns(count, seed=len(name)):
        meshes = solids(scene(tree, [f"{steps} {turn}" for steps in transforms], surfaces))
        assert {key: area(mesh) for key, mesh in meshes.items()} == {
            key: pytest.approx(a, **near) for key, a in areas.items()
        }
        if expected:
            assert_closed(meshes.values())
            assert volume(list(meshes.values())) == pytest.approx(expected, **near), turn


@pytest.mark.slow
def test_a_ball_less_itself_is_nothing_however_it_is_turned():
    for turn in turns(5, seed=8):
        with pytest.warns(SceneWarning, match="the tree's result is empty"):
            assert (
                solids(scene("- SPHERE 0 SPHERE 1", ["SCALE (1 2 3)", f"{turn.split('TRANSLATE')[0]} SCALE (1 2 3)"]))
                == {}
            )


def test_a_ball_in_a_pipe_of_its_own_width_does_not_show_through():
    # Their facets would cross along the circle in which they touch.
    for turn in turns(5, seed=10):
        with pytest.warns(SceneWarning, match="nothing is visible of SPHERE 1"):
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
