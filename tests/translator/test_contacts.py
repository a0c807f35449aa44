"""Curved solids in, on and across curved solids: their meshes stay within the tolerance and do not cross."""

import re
import warnings

import exact_csg
import numpy as np
import pytest
from meshes import area, assert_closed, scene, solids
from prosim_scene import SceneWarning
from prosim_scene.language import document_of
from prosim_scene.model import Leaf
from prosim_scene.view import camera_of

VIEW = "OBS 0 0 20 VRP 0 0 0 WINDOW -5 -5 5 5"
TURN = "ROTATE-X (33) ROTATE-Y (21) TRANSLATE (.1 .2 .3)"
FORMS = {"sphere": (1, 1, 1), "cylinder": (1, 1, 0), "cone": (1, 1, -1)}


def meshes_and_error(text):
    """The meshes of a scene, and their largest distance from the curved faces of their leaves, in pixels."""
    meshes, read, camera = solids(text, 0.1), document_of(text).scene, camera_of(document_of(text))
    leaves = {node.index: node for node in read.csg if isinstance(node, Leaf)}
    result = [0.0]
    for index, mesh in meshes.items():
        leaf = leaves[index]
        if leaf.shape == "cube":
            continue
        linear, offset = exact_csg.placed(read.transforms[index])
        a, b, c = np.moveaxis(mesh.positions[camera.may_see(mesh.positions)], 1, 0)
        points = np.concatenate([a, b, c, (a + b) / 2, (b + c) / 2, (c + a) / 2, (a + b + c) / 3])
        local = (points - offset) @ np.linalg.inv(linear).T
        value = local**2 @ FORMS[leaf.shape] - (leaf.shape != "cone")
        slope = np.linalg.norm((2 * local * FORMS[leaf.shape]) @ np.linalg.inv(linear), axis=1)
        disc = (leaf.shape != "sphere") & (np.minimum(np.abs(local[:, 2]), np.abs(local[:, 2] - 1)) < 1e-7)
        distance = np.where(disc, 0, np.abs(value) / np.maximum(slope, 1e-300))
        result.append((distance / camera.footprint(np.linalg.norm(points - camera.eye, axis=1))).max())
    return meshes, max(result)


def balls(radii, turns=True):
    """Steps of balls that touch one another in one point, where the largest one encloses the others."""
    return [f"ROTATE-X ({90 * r * turns}) SCALE ({r} {r} {r}) TRANSLATE ({r} 0 0) {TURN}" for r in radii]


def cavity(radius, gap):
    """A block, a cavity with its bottom at z = -3, and a marble of radius 1 this far above its bottom."""
    block, marble = "SCALE (40 40 20) TRANSLATE (-20 -20 -10)", f"TRANSLATE (0 0 {gap - 2})"
    return ["- CUBE 0 SPHERE 1", "SPHERE 2"], [
        block,
        f"SCALE ({radius} {radius} {radius}) TRANSLATE (0 0 {radius - 3})",
        marble,
    ]


TUBE = f"TRANSLATE (0 0 -.5) SCALE (1 1 4) {TURN}"
#: Solids in one another; the last one encloses the others.
INSIDE = {
    **{
        f"lens of {t} in a tube": (["SPHERE", "CYLINDER"], [f"SCALE (1 1 {t}) {TURN}", TUBE]) for t in (0.1, 1e-3, 1e-5)
    },
    "lens askew in a tube": (
        ["SPHERE", "CYLINDER"],
        [f"SCALE (1 .01 .1) ROTATE-X (30) {TURN}", f"TRANSLATE (0 0 -.5) SCALE (1 1 4) {TURN}"],
    ),
    "disc in a ball": (["SPHERE", "SPHERE"], [f"SCALE (1 1 .001) ROTATE-Y (12) {TURN}", TURN]),
    "disc on the wall of a ball": (
        ["SPHERE", "SPHERE"],
        [f"SCALE (.3 .3 .001) TRANSLATE (0 0 1.949) {TURN}", f"SCALE (2 2 2) {TURN}"],
    ),
    "ball in a flat ball": (["SPHERE", "SPHERE"], [f"SCALE (.1 .1 .1) {TURN}", f"SCALE (2 3 .1) {TURN}"]),
    "ball in an elliptic tube": (["SPHERE", "CYLINDER"], [TURN, f"SCALE (1 1.7 3) TRANSLATE (0 0 -1) {TURN}"]),
    "ball in a cone": (["SPHERE", "CONE"], [f"TRANSLATE (0 0 {2**0.5}) {TURN}", f"SCALE (3 3 3) {TURN}"]),
    "tube in a tube": (
        ["CYLINDER", "CYLINDER"],
        [f"ROTATE-Z (13) SCALE (.5 .5 1) TRANSLATE (.5 0 .2) {TURN}", f"SCALE (1 1 2) {TURN}"],
    ),
    "coating of a tube": (
        ["CYLINDER"] * 2,
        [f"ROTATE-Z (13) TRANSLATE (0 0 .1) SCALE (1 1 .8) {TURN}", f"SCALE (1.00001 1.00001 1) {TURN}"],
    ),
    "three coatings": (
        ["SPHERE"] * 4,
        [f"ROTATE-X ({77 * i}) SCALE ({1 + i / 1e4} {2 + i / 5e3} {1 + i / 1e4}) {TURN}" for i in range(4)],
    ),
    "two balls in a ball": (["SPHERE"] * 2, balls([1, 2])),
    "three deep": (["SPHERE"] * 3, balls([0.5, 0.8, 2])),
    "four deep": (["SPHERE"] * 4, balls([0.5, 1, 1.5, 2])),
    "three deep in a tube": (
        ["SPHERE", "SPHERE", "CYLINDER"],
        [f"SCALE (.4 .4 .4) TRANSLATE (.6 0 0) {TURN}", f"ROTATE-X (40) {TURN}", TUBE],
    ),
}


def test_truncated_cone_hides_a_ball_that_touches_it_from_inside():
    stump = f"SCALE (1 1 .9) TRANSLATE (0 0 .1) SCALE (3 3 3) {TURN}"
    meshes = solids(scene("+ SPHERE 0 CONE 1 radius .1", [INSIDE["ball in a cone"][1][0], stump]), 0.1)
    assert set(meshes) == {1}
    assert_closed(meshes.values())


@pytest.mark.parametrize("name", INSIDE)
@pytest.mark.parametrize("view", [VIEW, "OBS 3 -4 2 VRP 0 0 0 WINDOW -2 -2 2 2"], ids=["far", "near"])
def test_curved_solid_hides_solids_that_touch_it_from_inside(name, view):
    shapes, transforms = INSIDE[name]
    tree = "+ " * (len(shapes) - 1) + " ".join(f"{shape} {i}" for i, shape in enumerate(shapes))
    text = scene(tree, transforms).replace(VIEW, view)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        meshes, error = meshes_and_error(text)
    assert set(meshes) == {len(shapes) - 1} and error <= 0.1
    assert_closed(meshes.values())
    assert not [w for w in said if "pixels off" in str(w.message)]


@pytest.mark.parametrize("name", INSIDE)
def test_curved_solid_in_a_hollow_of_its_own_width_keeps_its_size(name):
    """The outermost solid is taken away from a block. All solids in it stay as large as they are."""
    shapes, transforms = INSIDE[name]
    count = len(shapes)
    tree = " ".join(
        [*["+"] * (count - 1), f"- CUBE {count}", *(f"{s} {i}" for i, s in reversed(list(enumerate(shapes))))]
    )
    text = scene(tree, [*transforms, f"SCALE (9 9 9) TRANSLATE (-4.5 -4.5 -4.5) {TURN}"])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SceneWarning)  # the innermost solids are hidden
        meshes, error = meshes_and_error(text)
    assert count - 2 in meshes and error <= 0.1


@pytest.mark.parametrize("radius", [5, 100, pytest.param(1e3, marks=pytest.mark.slow), 1e4])
@pytest.mark.parametrize("gap", [0, pytest.param(1e-5, marks=pytest.mark.slow), 2])
@pytest.mark.parametrize(
    "view", ["OBS 0 -18 0 VRP 0 0 -1 WINDOW -5 -5 5 5", "OBS 1 2 -1 VRP 0 0 -2.5 WINDOW -2 -2 2 2"]
)
def test_marble_in_a_cavity_keeps_its_size(radius, gap, view):
    (block, marble), transforms = cavity(radius, gap)
    text = scene(f"+ {block} {marble}", transforms).replace(VIEW, view)
    meshes, error = meshes_and_error(text)
    assert np.ptp(meshes[2].vertices, axis=0) == pytest.approx(2, abs=4e-3)
    assert error <= 0.1


@pytest.mark.parametrize("shape, inner", [("CYLINDER", ".9999 .9999 3"), ("SPHERE", ".9999 .9999 .9999")])
def test_thin_film_has_no_holes(shape, inner):
    """Its two meshes would cross, because the inner one is turned."""
    before = "TRANSLATE (0 0 -.5)" if shape == "CYLINDER" else ""
    transforms = [f"{before} {TURN}", f"{before} ROTATE-Z (13) SCALE ({inner}) {TURN}"]
    meshes, error = meshes_and_error(scene(f"- {shape} 0 {shape} 1", transforms))
    assert_closed(meshes.values())
    assert set(meshes) == {0, 1} and error <= 0.1
    expected = (2 if shape == "CYLINDER" else 4) * np.pi
    assert [area(meshes[i]) for i in (0, 1)] == pytest.approx([expected] * 2, rel=5e-3)


@pytest.mark.parametrize(
    "tree, radius, view, error",
    [
        ("+ SPHERE 0 SPHERE 1", 1e4, "OBS 0 -10 3 VRP 0 0 1 VUP 0 0 1 WINDOW -5 -5 5 5", (20, 200)),
        ("+ SPHERE 0 SPHERE 1", 10, "OBS 0 -10 3 VRP 0 0 1 VUP 0 0 1 WINDOW -5 -5 5 5", None),
        ("+ * SPHERE 0 CUBE 2 SPHERE 1", 1e4, "OBS 0 -10 3 VRP 0 0 1 VUP 0 0 1 WINDOW -5 -5 5 5", None),
        ("+ SPHERE 0 SPHERE 1", 1e4, "OBS 0 -10 3 VRP 0 -20 5 VUP 0 0 1 WINDOW -1 -1 1 1", None),
    ],
    ids=["near a planet", "near a ball", "near a part of a planet", "away from a planet"],
)
def test_face_that_cannot_be_fine_enough_is_named(tree, radius, view, error):
    ground = f"SCALE ({radius} {radius} {radius}) TRANSLATE (0 0 -{radius})"
    transforms = [ground, "TRANSLATE (0 0 1)", "SCALE (99 99 20) TRANSLATE (-49 -49 -10)"][: 3 if "2" in tree else 2]
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        solids(scene(tree, transforms).replace(VIEW, view), 0.1)
    found = [m for w in said if (m := re.search(r"up to (\S+) pixels off .* SPHERE 0 \(line 3\)", str(w.message)))]
    assert bool(found) == bool(error)
    assert not error or error[0] < float(found[0][1]) < error[1]
