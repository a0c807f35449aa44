"""Curved solids in, on and across curved solids: their meshes stay within the tolerance and do not cross."""

import re

import numpy as np
import pytest
from meshes import area, assert_closed, curved_face, is_side, scene, solids, turned, volume
from prosim_scene.language import document_of
from prosim_scene.view import camera_of

VIEW = "OBS 0 0 20 VRP 0 0 0 WINDOW -5 -5 5 5"
TURN = "ROTATE-X (33) ROTATE-Y (21) TRANSLATE (.1 .2 .3)"
#: Of the corners of a triangle, for its corners, the middles of its edges and its own.
WEIGHTS = np.array([*np.eye(3), *(1 - np.eye(3)) / 2, [1 / 3] * 3])


def meshes_and_error(text):
    """The meshes of a scene, and their largest distance from the curved faces of their leaves, in pixels."""
    meshes, camera, result = solids(text, 0.1), camera_of(document_of(text)), [0.0]
    for shape, index, radius in re.findall(r"(SPHERE|CYLINDER|CONE|TORUS) (\d+)((?: radius \S+)?)", text):
        if (mesh := meshes.get(index := int(index))) is None:
            continue
        local, linear = turned(text, index)
        triangles = mesh.positions[camera.may_see(mesh.positions)]
        triangles = triangles[is_side(shape, local(triangles))]
        points = WEIGHTS @ triangles
        value, gradient = curved_face(shape + radius, local(points))
        distance = np.abs(value) / np.maximum(np.linalg.norm(gradient @ linear, axis=2), 1e-300)
        pixels = distance / camera.footprint(np.linalg.norm(points - camera.eye, axis=2))
        result.append(pixels.max(initial=0))
    return meshes, max(result)


def balls(*radii):
    """Balls that touch one another in one point, where the largest one encloses the others."""
    return [f"SPHERE ROTATE-X ({90 * r}) SCALE ({r} {r} {r}) TRANSLATE ({r} 0 0)" for r in radii]


TUBE = "CYLINDER TRANSLATE (0 0 -.5) SCALE (1 1 4)"
#: Solids in one another, each with its steps before TURN; the last one encloses the others.
INSIDE = {
    **{f"lens of {t} in a tube": [f"SPHERE SCALE (1 1 {t})", TUBE] for t in (1e-3, 1e-5)},
    "lens askew in a tube": ["SPHERE SCALE (1 .01 .1) ROTATE-X (30)", TUBE],
    "disc in a ball": ["SPHERE SCALE (1 1 .001) ROTATE-Y (12)", "SPHERE"],
    "disc on the wall of a ball": ["SPHERE SCALE (.3 .3 .001) TRANSLATE (0 0 1.949)", "SPHERE SCALE (2 2 2)"],
    "ball in a flat ball": ["SPHERE SCALE (.1 .1 .1)", "SPHERE SCALE (2 3 .1)"],
    "ball in an elliptic tube": ["SPHERE", "CYLINDER SCALE (1 1.7 3) TRANSLATE (0 0 -1)"],
    "ball in a cone": [f"SPHERE TRANSLATE (0 0 {2**0.5})", "CONE SCALE (3 3 3)"],
    "ball in a stump": [
        f"SPHERE TRANSLATE (0 0 {2**0.5})",
        "CONE radius .1 SCALE (1 1 .9) TRANSLATE (0 0 .1) SCALE (3 3 3)",
    ],
    "tube in a tube": ["CYLINDER ROTATE-Z (13) SCALE (.5 .5 1) TRANSLATE (.5 0 .2)", "CYLINDER SCALE (1 1 2)"],
    "cone in a cone": ["CONE ROTATE-Z (13) SCALE (1.9 1.9 1.9) TRANSLATE (0 0 .0001)", "CONE SCALE (2 2 2)"],
    "stump in a stump": ["CONE radius .4 ROTATE-Z (13) SCALE (.9 .9 .771) TRANSLATE (0 0 .1)", "CONE radius .29"],
    "stump in a cone": ["CONE radius .4 ROTATE-Z (13) SCALE (.9 .9 .54) TRANSLATE (0 0 .36001)", "CONE"],
    "three cones": [f"CONE SCALE ({2 - i / 5} {1 - i / 10} {2 - i / 5}) TRANSLATE (0 0 {i / 1e4})" for i in (2, 1, 0)],
    "ball in a ring": ["SPHERE SCALE (.4 .4 .4) TRANSLATE (.6 .8 0)", "TORUS radius .4"],
    "lens in a ring": ["SPHERE SCALE (.4 .01 .4) TRANSLATE (1 0 0)", "TORUS radius .4 SCALE (1 1 1.3)"],
    "ring in a ball": ["TORUS SCALE (.8 .8 .8)", "SPHERE"],
    "ring in a tube": ["TORUS SCALE (.8 .8 .8)", TUBE],
    "ring in a ring": ["TORUS radius .3999 ROTATE-Z (13)", "TORUS radius .4 ROTATE-X (180) SCALE (1 1 1.0001)"],
    "ring on the wall of a ring": [
        "TORUS radius .1 ROTATE-Z (13) SCALE (1.2 1.2 1.2) TRANSLATE (0 0 .2)",
        "TORUS radius .40285",
    ],
    "coating of a tube": [
        "CYLINDER ROTATE-Z (13) TRANSLATE (0 0 .1) SCALE (1 1 .8)",
        "CYLINDER SCALE (1.00001 1.00001 1)",
    ],
    "three coatings": [
        f"SPHERE ROTATE-X ({77 * i}) SCALE ({1 + i / 1e4} {2 + i / 5e3} {1 + i / 1e4})" for i in range(4)
    ],
    "two balls in a ball": balls(1, 2),
    "three deep": balls(0.5, 0.8, 2),
    "four deep": balls(0.5, 1, 1.5, 2),
    "three deep in a tube": ["SPHERE SCALE (.4 .4 .4) TRANSLATE (.6 0 0)", "SPHERE ROTATE-X (40)", TUBE],
}


def shapes_and_transforms(name):
    """The leaves and the transforms of the solids INSIDE."""
    parts = [re.match(r"(\w+)((?: radius \S+)?)(.*)", solid).groups() for solid in INSIDE[name]]
    return [f"{shape} {i}{radius}" for i, (shape, radius, _) in enumerate(parts)], [f"{p[2]} {TURN}" for p in parts]


@pytest.mark.slow
@pytest.mark.parametrize("name", INSIDE)
@pytest.mark.parametrize("view", [VIEW, "OBS 3 -4 2 VRP 0 0 0 WINDOW -2 -2 2 2"], ids=["far", "near"])
def test_curved_solid_hides_solids_that_touch_it_from_inside(name, view, recwarn):
    shapes, transforms = shapes_and_transforms(name)
    tree = "+ " * (len(shapes) - 1) + " ".join(shapes)
    text = scene(tree, transforms).replace(VIEW, view)
    meshes, error = meshes_and_error(text)
    assert set(meshes) == {len(shapes) - 1} and error <= 0.1
    assert_closed(meshes.values())
    assert not [w for w in recwarn if "pixels off" in str(w.message)]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:nothing is visible")
@pytest.mark.parametrize("name", INSIDE)
def test_curved_solid_in_a_hollow_of_its_own_width_keeps_its_size(name):
    """The outermost solid is taken away from a block. All solids in it stay as large as they are."""
    shapes, transforms = shapes_and_transforms(name)
    count = len(shapes)
    tree = " ".join([*["+"] * (count - 1), f"- CUBE {count}", *reversed(shapes)])
    text = scene(tree, [*transforms, f"SCALE (9 9 9) TRANSLATE (-4.5 -4.5 -4.5) {TURN}"])
    meshes, error = meshes_and_error(text)
    assert count - 2 in meshes and error <= 0.1


@pytest.mark.slow
@pytest.mark.parametrize("gap", [0, 1e-5])
@pytest.mark.parametrize("radius", [5, 100, 1e4])
def test_marble_in_a_cavity_keeps_its_size(radius, gap, recwarn):
    """The marble of radius 1 is this far above the bottom of a cavity in a block, at z = -3."""
    block = "SCALE (40 40 20) TRANSLATE (-20 -20 -10)"
    cavity = f"SCALE ({radius} {radius} {radius}) TRANSLATE (0 0 {radius - 3})"
    text = scene("+ - CUBE 0 SPHERE 1 SPHERE 2", [block, cavity, f"TRANSLATE (0 0 {gap - 2})"])
    meshes, error = meshes_and_error(text.replace(VIEW, "OBS 0 -18 0 VRP 0 0 -1 WINDOW -5 -5 5 5"))
    assert np.ptp(meshes[2].vertices, axis=0) == pytest.approx(2, abs=4e-3) and error <= 0.1
    assert not [w for w in recwarn if "pixels off" in str(w.message)]


@pytest.mark.slow
def test_intersection_with_a_ball_that_touches_it_keeps_its_size(recwarn):
    radius, turn = 1.4341220657382818, "ROTATE-X (67.40375360835552) ROTATE-Y (61.1315256290909)"
    inner = f"ROTATE-X (104.5) ROTATE-Y (131.9) ROTATE-Z (192) SCALE ({radius} {radius} {radius})"
    steps = [
        f"{inner} TRANSLATE (.24919075088496498 .30270271097689927 .40803538440303505) {turn}",
        f"ROTATE-X (41.2) ROTATE-Y (290.8) ROTATE-Z (152.3) SCALE (2 2 2) {turn}",
    ]
    text = scene("* SPHERE 1 SPHERE 0", steps).replace(VIEW, "OBS 8 -5.4 -11.6 VRP 0 0 0 WINDOW -2 -1.5 2 1.5")
    meshes, error = meshes_and_error(text)
    assert np.ptp(meshes[0].vertices, axis=0) == pytest.approx(2 * radius, abs=4e-3) and error <= 0.1
    assert not [w for w in recwarn if "pixels off" in str(w.message)]


@pytest.mark.slow
@pytest.mark.parametrize(
    "tree, seen", [("- + CUBE 2 SPHERE 1 SPHERE 0", {0, 2}), ("+ + SPHERE 0 SPHERE 1 CUBE 2", {2})]
)
@pytest.mark.parametrize("radius, small, z", [(20, ".05 .05 .05", 0.05), (200, ".3 .3 .001", 0.0013)])
def test_large_ball_under_a_plane_stays_below_it(tree, seen, radius, small, z, recwarn):
    """The ball touches the plane; a small or flat one touches the ball from inside, at the same place, and is named."""
    large = f"SCALE ({radius} {radius} {radius}) TRANSLATE (0 0 -{radius})"
    block = f"SCALE (900 900 {3 * radius}) TRANSLATE (-450 -450 -{3 * radius})"
    text = scene(tree, [f"SCALE ({small}) TRANSLATE (0 0 -{z})", large, block])
    meshes = solids(text.replace(VIEW, "OBS 0 -3 8 VRP 0 0 0 WINDOW -2 -2 2 2"), 0.1)
    assert any("pixels off instead of 0.1: SPHERE 0 (line 3)" in str(w.message) for w in recwarn)
    assert set(meshes) == seen and all(np.all(mesh.vertices[:, 2] <= 0) for mesh in meshes.values())


@pytest.mark.parametrize("operator, squared", [("-", 0.4**2 - 0.35**2), ("*", 0.35**2), ("+", 0.4**2)])
def test_rings_with_one_transform_have_their_own_radii(operator, squared):
    """Nearly equal tori have the same facets, also if one TRANSFORM places both."""
    meshes = solids(scene(f"{operator} TORUS 0 radius .4 TORUS 1 radius .35", ["ROTATE-X (33)"] * 2)).values()
    assert volume(meshes) == pytest.approx(2 * np.pi**2 * squared, rel=0.02)


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


ABOVE = "OBS 0 -10 3 VRP 0 0 1 VUP 0 0 1 WINDOW -5 -5 5 5"
#: Tree, radius of its SPHERE 0, view, and the error that is named, in pixels: near a planet, a ball, and a part of a
#: planet, away from a planet, in a large cavity.
COARSE = [
    ("+ SPHERE 0 SPHERE 1", 1e4, ABOVE, (20, 200)),
    ("+ SPHERE 0 SPHERE 1", 10, ABOVE, None),
    ("+ * SPHERE 0 CUBE 2 SPHERE 1", 1e4, ABOVE, None),
    ("+ SPHERE 0 SPHERE 1", 1e4, "OBS 0 -10 3 VRP 0 -20 5 VUP 0 0 1 WINDOW -1 -1 1 1", None),
    ("+ - CUBE 3 SPHERE 0 SPHERE 1", 1e4, "OBS 0 -10 -3 VRP 0 0 -1 VUP 0 0 1 WINDOW -5 -5 5 5", (20, 200)),
]


@pytest.mark.slow
@pytest.mark.parametrize("tree, radius, view, error", COARSE)
def test_face_that_cannot_be_fine_enough_is_named(tree, radius, view, error, recwarn):
    ground = f"SCALE ({radius} {radius} {radius}) TRANSLATE (0 0 -{radius})"
    transforms = [ground, "TRANSLATE (0 0 1)", "SCALE (99 99 20) TRANSLATE (-49 -49 -10)"]
    transforms.append("TRANSLATE (-.5 -.5 -.5) SCALE (9e4 9e4 9e4)")
    solids(scene(tree, transforms).replace(VIEW, view), 0.1)
    found = [m for w in recwarn if (m := re.search(r"up to (\S+) pixels off .* SPHERE 0 \(line 3\)", str(w.message)))]
    assert bool(found) == bool(error)
    assert not error or error[0] < float(found[0][1]) < error[1]
