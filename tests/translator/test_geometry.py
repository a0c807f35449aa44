"""Solids: volumes and areas against closed forms, closedness, normals, and who owns a face."""

import math
import warnings

import numpy as np
import prosim_scene
import pytest
from meshes import area, assert_closed, scene, solids, volume
from prosim_scene import SceneWarning
from prosim_scene.geometry.transforms import matrix
from prosim_scene.language import document_of
from prosim_scene.view import camera_of

PRIMITIVES = {
    "CUBE": (1.0, 6.0),
    "SPHERE": (4 / 3 * math.pi, 4 * math.pi),
    "CYLINDER": (math.pi, 4 * math.pi),
    "CONE": (math.pi / 3, math.pi * (1 + math.sqrt(2))),
}


@pytest.mark.slow
@pytest.mark.parametrize("shape", PRIMITIVES)
@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1), (2, 0.5, -1)])
def test_canonical_solids(shape, scale):
    steps = f"SCALE {scale} ROTATE-X (37) ROTATE-Z (-80) TRANSLATE (1 2 -1)".replace(",", "")
    meshes = list(solids(scene(f"{shape} 0", [steps]), tolerance=0.001).values())
    assert_closed(meshes)
    expected, surface = PRIMITIVES[shape]
    assert volume(meshes) == pytest.approx(expected * abs(np.prod(scale)), rel=1e-4)
    if scale[0] ** 2 == 1 and scale[1] == 1:
        assert sum(map(area, meshes)) == pytest.approx(surface, rel=1e-4)


@pytest.mark.parametrize("shape, form", [("SPHERE", (1, 1, 1)), ("CYLINDER", (1, 1, 0)), ("CONE", (1, 1, -1))])
@pytest.mark.parametrize("sign", [1, -1], ids=["added", "taken away"])
def test_normals_are_those_of_the_quadric_after_cuts(shape, form, sign):
    transforms = ["SCALE (2 1 1.5) ROTATE-Y (30)", "SCALE (9 9 9) TRANSLATE (.2 -4 -4)"]
    text = scene(f"{'+' if sign > 0 else '-'} CUBE 1 {shape} 0", transforms)
    meshes = solids(text)
    assert_closed(meshes.values())
    to_local = np.linalg.inv(matrix(prosim_scene.parse(text).transforms[0]))
    p = meshes[0].positions
    local = p @ to_local[:3, :3].T + to_local[:3, 3]
    normals = meshes[0].normals[meshes[0].index]
    expected = sign * (local * form) @ to_local[:3, :3]
    length = np.linalg.norm(expected, axis=2)
    disc = (shape != "SPHERE") & (np.ptp(local[..., 2], axis=1) < 1e-6)
    chosen = ~disc[:, None] & (length > 1e-6)  # not at the apex
    cosine = np.einsum("tci,tci->tc", normals, expected)[chosen] / length[chosen]
    assert chosen.any() and cosine.min() > np.cos(np.radians(0.1))
    wound = np.einsum("ti,tci->t", np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), normals)
    assert wound.min() > -1e-8  # the triangles are wound to the same side


def test_chord_error_is_below_the_tolerance():
    text = scene("SPHERE 0", ["SCALE (3 1 1)"])
    camera = camera_of(document_of(text))
    for tolerance in (0.5, 0.05):
        p = solids(text, tolerance)[0].positions / [3, 1, 1]
        n = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        distance = np.abs(np.einsum("ti,ti->t", n / np.linalg.norm(n, axis=1, keepdims=True), p[:, 0]))
        assert 3 * (1 - distance.min()) <= tolerance * camera.footprint(20 - 1) * 1.02


def test_what_vanishes_is_reported():
    with pytest.warns(SceneWarning, match=r"nothing is visible of SPHERE 1 \(line 3\)"):
        solids(scene("+ CUBE 0 SPHERE 1", ["", "SCALE (.1 .1 .1) TRANSLATE (.5 .5 .5)"]))
    with pytest.warns(SceneWarning, match="the tree's result is empty"):
        assert solids(scene("* CUBE 0 SPHERE 1", ["", "TRANSLATE (9 9 9)"])) == {}
    with pytest.warns(SceneWarning, match="the tree's result is empty"):
        assert solids(scene("- CUBE 0 CUBE 0", [""])) == {}


def test_what_fills_a_hollow_has_not_vanished():
    """Its face is that of what has cut the hollow, and behind it is the wine; not so where the wine is in the glass."""
    glass, wine = "material dieletrico n-refr = 1.5", "material dieletrico n-refr = 1.34"
    sizes = ["SCALE (2 2 2)", "SCALE (1.8 1.8 1.8)", "SCALE (1.8 1.8 1.8)", "SCALE (4 4 4) TRANSLATE (0 -2 0)"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solids(scene("+ - SPHERE 0 SPHERE 1 SPHERE 2", sizes[:3], [glass, glass, wine]), 0.5)
        solids(scene("+ - SPHERE 0 SPHERE 1 * SPHERE 2 CUBE 3", sizes, [glass, glass, wine, wine]), 0.5)
    with pytest.warns(SceneWarning, match="nothing is visible of SPHERE 1"):
        solids(scene("+ SPHERE 0 SPHERE 1", sizes[:2], [glass, wine]), 0.5)


@pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")
def test_depth_of_nesting_needs_no_recursion():
    assert volume(solids(scene("+ CUBE 0 " * 1100 + "CUBE 0", [""])).values()) == pytest.approx(1)


def test_a_solid_that_vanishes_by_an_operator_between_its_operands_is_told_of_the_order(write_scene):
    """The tree is valid, but means something else than + + + A (B * C)."""
    tree = "+ + +\nCYLINDER 1\n- CYLINDER 2 *\nCONE 3\nCYLINDER 4\nSPHERE 5 SPHERE 6\n"
    tables = "".join(f"SURFACE {i}\nTRANSFORM {i} TRANSLATE ({5 * i} 0 0)\n" for i in range(1, 7))
    path = write_scene(f"LIGHTS POINT position 0 9 9\nCSG-TREE {tree}{tables}END\n")
    expected = (
        r"nothing is visible of CONE 3 \(line 5\), CYLINDER 4 \(line 6\): .*operators come before their operands: "
        r"\* \(line 4\) has the operands CONE 3 \(line 5\) and CYLINDER 4 \(line 6\)"
    )
    with pytest.warns(SceneWarning, match=expected) as warned:
        prosim_scene.check(path)
    assert len(warned) == 1
