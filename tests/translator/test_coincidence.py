"""Faces that coincide but for rounding: no film of no thickness, no face of the wrong primitive, a closed surface."""

import math
import re

import numpy as np
import pytest
from meshes import area, assert_closed, scene, solids, volume
from prosim_scene import SceneWarning

GLASS = "material dieletrico n-refr = 1.5"
BESIDE = "+ CUBE 0 CUBE 1", "", "TRANSLATE (1 0 0)"


def turns(count, seed=1):
    """Steps of random rotations with a move."""
    rng = np.random.default_rng(seed)
    for x, y, z in rng.uniform(-180, 180, (count, 3)):
        yield f"ROTATE-X ({x}) ROTATE-Y ({y}) ROTATE-Z ({z}) TRANSLATE ({x / 90} {y / 90} {z / 90})"


#: Name -> the tree and its transforms (then comes a random turn); areas of the meshes and their volume; random turns.
TURNED = {
    "a flush cut is open": (
        ("- CUBE 0 CUBE 1", "", "SCALE (.5 .5 .5) TRANSLATE (.25 .25 .5)"),
        ({0: 6 - 0.25, 1: 5 * 0.25}, 1 - 0.125),
        4,
    ),
    "touching blocks have no wall": (BESIDE, ({0: 5, 1: 5}, 2), 15),
    "two glasses have one interface": (BESIDE, ({0: 5, 1: 5, (0, 1): 1}, None), 12),
    "blocks that touch along an edge": (("+ CUBE 0 CUBE 1", "", "TRANSLATE (1 0 1)"), ({0: 6, 1: 6}, 2), 8),
    "a band on a pole of its own width hides the pole": (
        ("+ CYLINDER 0 CYLINDER 1", "ROTATE-Z (17) SCALE (1 1 2) TRANSLATE (0 0 4)", "SCALE (1 1 10)"),
        ({0: 4 * math.pi, 1: 18 * math.pi}, 10 * math.pi),
        4,
    ),
    "a pole less a shorter one": (  # of which there is the disc, and nothing of its side
        ("- CYLINDER 0 CYLINDER 1", "SCALE (1 1 10)", "SCALE (1 -1 5) ROTATE-Z (31)"),
        ({0: 11 * math.pi, 1: math.pi}, 5 * math.pi),
        4,
    ),
}


@pytest.mark.parametrize("name", TURNED)
def test_coincident_faces_of_turned_solids(name):
    (tree, *transforms), (areas, expected), count = TURNED[name]
    surfaces = (GLASS, GLASS.replace("1.5", "1.33")) if "glasses" in name else ()
    near = {"rel": 3e-3} if "C" in re.sub("CUBE", "", tree) else {"abs": 1e-6}
    for turn in turns(count, seed=len(name)):
        meshes = solids(scene(tree, [f"{steps} {turn}" for steps in transforms], surfaces))
        assert {key: area(mesh) for key, mesh in meshes.items()} == {
            key: pytest.approx(a, **near) for key, a in areas.items()
        }
        if expected:
            assert_closed(meshes.values())
            assert volume(list(meshes.values())) == pytest.approx(expected, **near), turn


@pytest.mark.parametrize(
    "tree, transforms, words",
    [
        ("- SPHERE 0 SPHERE 1", ["SCALE (1 2 3)", "{turn} SCALE (1 2 3)"], "the tree's result is empty"),
        # Their facets would cross along the circle in which they touch.
        (
            "+ CYLINDER 0 SPHERE 1",
            ["SCALE (1 1 4) TRANSLATE (0 0 -2) {turn}", "ROTATE-Y (40) {turn}"],
            "nothing is visible of SPHERE 1",
        ),
    ],
    ids=["a ball less itself", "a ball in a pipe of its own width"],
)
def test_what_vanishes_however_it_is_turned(tree, transforms, words):
    for turn in turns(2, seed=10):
        turn = turn.split("TRANSLATE")[0]
        with pytest.warns(SceneWarning, match=words):
            solids(scene(tree, [steps.format(turn=turn) for steps in transforms]), 0.3)
