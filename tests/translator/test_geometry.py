"""Solids: volumes and areas against closed forms, closedness, normals, who owns a face, how fine curved faces are.

Faces that coincide but for rounding: no film of no thickness, no face of the wrong primitive, a closed surface.
"""

import math
import re
import warnings
from types import SimpleNamespace

import mitsuba as mi
import numpy as np
import prosim_scene
import pytest
from manifold3d import Manifold, Mesh64
from meshes import area, assert_closed, curved_face, is_side, scene, solids, turned, volume
from prosim_scene import SceneError, SceneWarning
from prosim_scene.geometry import csg, detail, surfaces
from prosim_scene.geometry.leaves import leaves_of
from prosim_scene.language import document_of
from prosim_scene.view import camera_of

CURVED = ["SPHERE 0", "CYLINDER 0", "CONE 0", "CONE 0 radius .4", "TORUS 0 radius .4", "TORUS 0"]


@pytest.mark.parametrize("shape", CURVED)
@pytest.mark.parametrize("sign", [1, -1], ids=["added", "taken away"])
def test_normals_and_uv_are_those_of_the_face_after_cuts(shape, sign):
    """v is the height, or the angle around the tube of a torus, or from the pole of a ball."""
    transforms = ["SCALE (2 -1 1.5) ROTATE-Y (30)", "SCALE (9 9 9) TRANSLATE (.2 -4 -4)"]
    text = scene(f"{'+' if sign > 0 else '-'} CUBE 1 {shape} t-brick", transforms)
    meshes = solids(text)
    assert_closed(meshes.values())
    mesh, (local, linear) = meshes[0], turned(text)
    p, uv, normals = local(mesh.positions), mesh.uv[mesh.index], mesh.normals[mesh.index]
    side, (value, gradient) = is_side(shape, p), curved_face(shape, p)
    uncut = np.abs(mesh.positions[..., 0] - 0.2) > 1e-6
    assert np.abs(value)[side[:, None] & uncut].max() < 1e-8
    expected = sign * gradient @ linear
    length = np.linalg.norm(expected, axis=2)
    chosen = side[:, None] & (length > 1e-6)  # not at the apex
    cosine = np.einsum("tci,tci->tc", normals, expected)[chosen] / length[chosen]
    assert chosen.any() and cosine.min() > np.cos(np.radians(0.1))
    flat = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]) @ np.linalg.inv(linear).T * np.linalg.det(linear)
    assert np.einsum("ti,tci->tc", flat, normals).min() > -1e-8  # the triangles are wound to the same side
    assert uv[~side] == pytest.approx(p[~side][..., :2] / 2 + 0.5, abs=1e-6)
    rho, z = np.linalg.norm(p[..., :2], axis=2), p[..., 2]
    v = {"T": np.arctan2(z, rho - 1) / (2 * np.pi), "S": np.arctan2(rho, z) / np.pi}.get(shape[0], z)
    for found, turns in ((uv[..., 0], np.arctan2(p[..., 1], p[..., 0]) / (2 * np.pi)), (uv[..., 1], v)):
        around = side[:, None] & (rho > 1e-5)
        assert np.abs((found - turns + 0.5) % 1 - 0.5)[around].max() < 1e-5
    for seam in (uv[..., 0], uv[..., 1] if "TORUS" in shape else 0 * v):
        assert np.ptp(seam, axis=1)[side].max() < 0.3  # no triangle goes back over the seam


@pytest.mark.slow
@pytest.mark.parametrize("shape", [*CURVED, "TORUS 0 radius .05"])
@pytest.mark.parametrize("steps", ["", "SCALE (3 1 2) ROTATE-X (70)"])
def test_curved_faces_are_as_fine_as_promised(shape, steps):
    """The distance to the face of points on the triangles, over the gradient, is below the tolerance in pixels."""
    text = scene(shape, [steps])
    camera, (local, linear) = camera_of(document_of(text)), turned(text)
    weights = np.random.default_rng(0).dirichlet([1, 1, 1], 20)
    for tolerance in (0.5, 0.05):
        points = weights @ solids(text, tolerance)[0].positions
        value, gradient = curved_face(shape, local(points))
        value[~is_side(shape, local(points))] = 0
        distance = np.abs(value) / np.linalg.norm(gradient @ linear, axis=2)
        pixel = camera.footprint(20 - np.abs(points).max())
        assert 0.1 * tolerance * pixel < distance.max() <= 1.02 * tolerance * pixel


def test_warning_names_a_primitive_without_visible_faces():
    with pytest.warns(SceneWarning, match=r"nothing is visible of SPHERE 1 \(line 3\)"):
        solids(scene("+ CUBE 0 SPHERE 1", ["", "SCALE (.1 .1 .1) TRANSLATE (.5 .5 .5)"]))
    text = scene("+ half 2 half 3", ["", "", "", "SCALE (1 1 -1)"]).replace("CSG", "SOLID half - SPHERE 0 PLANE 1 CSG")
    with pytest.warns(SceneWarning, match=r"nothing is visible of a PLANE in half 2 \(line 3\), a PLANE in half 3"):
        solids(text)
    with pytest.warns(SceneWarning, match="the tree's result is empty"):
        assert solids(scene("* CUBE 0 SPHERE 1", ["", "TRANSLATE (9 9 9)"])) == {}


def test_liquid_that_fills_a_hollow_causes_no_warning():
    """Its face is that of what has cut the hollow, and behind it is the wine; not so where the wine is in the glass."""
    glass, wine = "material dieletrico n-refr = 1.5", "material dieletrico n-refr = 1.34"
    sizes = ["SCALE (2 2 2)", "SCALE (1.8 1.8 1.8)", "SCALE (1.8 1.8 1.8)", "SCALE (4 4 4) TRANSLATE (0 -2 0)"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solids(scene("+ - SPHERE 0 SPHERE 1 SPHERE 2", sizes[:3], [glass, glass, wine]), 0.5)
        solids(scene("+ - SPHERE 0 SPHERE 1 * SPHERE 2 CUBE 3", sizes, [glass, glass, wine, wine]), 0.5)
    with pytest.warns(SceneWarning, match="nothing is visible of SPHERE 1"):
        solids(scene("+ SPHERE 0 SPHERE 1", sizes[:2], [glass, wine]), 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("tree", ["+ CUBE 0 " * 5000 + "CUBE 0", "+ " * 5000 + "CUBE 0 " * 5001])
def test_depth_of_nesting_needs_no_recursion(tree):
    text = scene(tree, [""])
    assert volume(solids(text).values()) == pytest.approx(1) and len(repr(prosim_scene.parse(text))) > 10_001


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


# ---- How fine curved faces are, and that what is too much is coarser or refused

BALLS = [f"SCALE (.4 .4 .4) TRANSLATE ({i % 5 - 2} {i // 5 - 2} 0)" for i in range(20)]
UNION = "+ " * 19 + " ".join(f"SPHERE {i}" for i in range(20))


def segments(tree, transforms, window="-5 -5 5 5"):
    """Around a circle, of the leaves of a scene under a view."""
    document = document_of(scene(tree, transforms).replace("-5 -5 5 5", window), "test.scn")
    leaves = leaves_of(document, camera_of(document), 0.1, np.zeros(len(transforms), bool), {})
    return [leaves.solids[i].segments for i in leaves.of_leaf]


def test_solids_outside_the_window_have_fewer_segments():
    plain = segments(UNION, BALLS)
    zoomed = segments(UNION, BALLS, "-2.1 -2.1 -1.9 -1.9")
    assert zoomed[0] > 5 * plain[0]  # the ball in the middle of the picture
    assert max(zoomed[1:]) <= 128 and min(zoomed[1:]) >= min(plain[1:])


RADIUS, RIM = 20, 1
SAGITTA = RADIUS - (RADIUS**2 - RIM**2) ** 0.5
CAP = np.pi * SAGITTA**2 * (3 * RADIUS - SAGITTA) / 3


@pytest.mark.parametrize("tree, expected", [("* SPHERE 0 SPHERE 1", 2 * CAP), ("- CUBE 2 SPHERE 0", 5.76 - CAP)])
def test_the_rim_of_a_lens_is_as_fine_as_its_faces(tree, expected, recwarn):
    center = np.array([0, 0, SAGITTA - RADIUS])
    ball = f"SCALE ({RADIUS} {RADIUS} -{RADIUS}) TRANSLATE (0 0 {{}})"
    transforms = [ball.format(z) for z in (center[2], -center[2])] + ["SCALE (2.4 2.4 1) TRANSLATE (-1.2 -1.2 0)"]
    meshes = solids(scene(tree, transforms).replace("WINDOW -5 -5 5 5", "WINDOW -2 -2 2 2"), 0.4)
    assert volume(meshes.values()) == pytest.approx(expected, abs=8e-3 * CAP)
    outwards = (meshes[0].positions - center) * (-1 if tree[0] == "-" else 1)
    assert outwards == pytest.approx(RADIUS * meshes[0].normals[meshes[0].index], abs=1e-4)
    x, y, z = meshes[0].positions.reshape(-1, 3).T
    pixel = 4 / 500
    assert np.abs(np.hypot(x, y)[z < 1e-6] - RIM).max() < 0.4 * pixel
    assert not any("far from the origin" in str(w.message) for w in recwarn)  # as the eye is not far from the ball


def test_solids_that_take_long_cause_one_warning(monkeypatch, recwarn):
    monkeypatch.setattr(surfaces, "PATIENCE", -1.0)
    solids(scene("+ SPHERE 0 - SPHERE 1 SPHERE 2", ["", "TRANSLATE (1 0 0)", "TRANSLATE (1.5 0 0)"]))
    (said,) = recwarn
    assert "because many of them meet at one place; use fewer of them, or the option --tolerance" in str(said.message)
    assert said.message.line == 2


@pytest.mark.parametrize("module, name", [(csg, "Manifold"), (surfaces, "manifold")])
def test_solids_that_manifold3d_refuses_are_an_error_at_their_line(monkeypatch, module, name):
    open_mesh = Manifold(Mesh64(np.eye(3), np.array([[0, 1, 2]], np.uint64)))
    fake = SimpleNamespace(batch_boolean=lambda *_: open_mesh) if name == "Manifold" else lambda *_: open_mesh
    monkeypatch.setattr(module, name, fake)
    words = r"the solids at SPHERE 0 \(line 3\) cannot be combined: manifold3d reports NotManifold; move this solid"
    with pytest.raises(SceneError, match=words) as error:
        solids(scene("- SPHERE 0 SPHERE 1", ["", "TRANSLATE (1 0 0)"]))
    assert error.value.line == 3


def test_more_triangles_than_memory_holds_are_coarser_or_an_error(monkeypatch):
    monkeypatch.setattr(detail, "MAX_TRIANGLES", 10_000)
    with pytest.warns(SceneWarning, match="curved faces are approximated to .* pixels instead of 0.1"):
        n = segments(UNION, BALLS)
    assert sum(k * k // 2 for k in n) <= 10_000
    monkeypatch.setattr(detail, "MAX_TRIANGLES", 1000)
    words = "20 different primitives have at least 2,560 triangles; expected 1,000 at most"
    with pytest.raises(SceneError, match=words) as error:
        segments(UNION.replace("+", "*"), [steps.replace(".4", ".51") for steps in BALLS])
    assert error.value.line == 2


@pytest.mark.parametrize("distance, said", [(0, False), (1e3, False), (1e6, True), (1e9, True)])
def test_a_scene_far_from_the_origin_is_exact_in_itself_and_warned_of(distance, said, recwarn):
    def at(d):
        steps = [f"TRANSLATE ({d} 0 0)", f"SCALE (.25 .25 1) TRANSLATE ({d + 0.5} .5 0)"]
        text = scene("- CUBE 0 CYLINDER 1", steps)
        return solids(text.replace("OBS 0 0 20 VRP 0 0 0", f"OBS {d} 0 20 VRP {d} 0 0"))

    here, there = at(0), at(distance)
    assert any("far from the origin" in str(w.message) for w in recwarn) == said
    for index in here:
        assert area(there[index]) == pytest.approx(area(here[index]), rel=max(1e-6, 1e-15 * distance))
        assert len(here[index].positions) == len(there[index].positions)


def test_needles_have_few_segments():
    # With more segments, two of them take manifold3d minutes.
    assert segments("SPHERE 0", ["SCALE (.1 .1 1000) ROTATE-X (90)"])[0] < 256


# ---- Half-spaces

SIDES = ["", "ROTATE-X (90)", "ROTATE-X (180)", "ROTATE-X (270)", "ROTATE-Y (90)", "ROTATE-Y (270)"]
SIX = [f"TRANSLATE (0 0 1) {turn}" for turn in SIDES]
ROOM = "* * * * * PLANE 0 PLANE 1 PLANE 2 PLANE 3 PLANE 4 PLANE 5"


@pytest.mark.filterwarnings("ignore:.*nothing is visible of (CUBE|PLANE)")
@pytest.mark.parametrize(
    "tree, transforms, expected",
    [
        ("* CUBE 1 PLANE 0", ["TRANSLATE (0 0 .25)", ""], 0.25),
        ("- CUBE 1 PLANE 0", ["SCALE (1 1 -1) TRANSLATE (0 0 .25)", ""], 0.25),
        ("- CUBE 1 PLANE 0", ["SCALE (1e9 1e9 1e9) TRANSLATE (0 0 .25)", ""], 0.75),
        ("- CUBE 1 PLANE 0", ["SCALE (1e5 1e-5 1) TRANSLATE (0 0 .25)", ""], 0.75),
        ("- CUBE 1 PLANE 0", ["MATRIX (1 0 99 0 0 1 -50 0 0 0 1 .25)", ""], 0.75),
        ("* CUBE 1 PLANE 0", ["TRANSLATE (1e6 -1e6 .25)", ""], 0.25),
        ("- CUBE 1 PLANE 0", ["TRANSLATE (0 0 -1e6)", ""], 1),
        ("* CUBE 1 PLANE 0", ["TRANSLATE (0 0 1e6)", ""], 1),
        ("- CUBE 1 PLANE 0", ["TRANSLATE (1e6 0 .25)", "TRANSLATE (1e6 0 0)"], 0.75),
        (ROOM, SIX, 8),
        (f"* CUBE 6 {ROOM}", [*SIX, "TRANSLATE (-.5 -.5 -.5) SCALE (4 4 4)"], 8),
        (f"- CUBE 6 {ROOM}", [*SIX, "TRANSLATE (-.5 -.5 -.5) SCALE (4 4 4)"], 56),
    ],
)
def test_plane_cuts_wherever_the_solids_are(tree, transforms, expected):
    assert volume(solids(scene(tree, transforms)).values()) == pytest.approx(expected, rel=1e-6)


def test_floor_reaches_far():
    mesh = solids(scene("+ PLANE 0 SPHERE 1", ["ROTATE-X (-90) TRANSLATE (0 -1 0)", ""]))[0]
    x, y, z = mesh.vertices.T
    assert y.max() == pytest.approx(-1) and min(-x.min(), x.max(), -z.min(), z.max()) > 900


@pytest.mark.slow
def test_floor_has_no_holes(variant_rgb, write_scene):
    """Long narrow triangles that end at the solids would have some, because Mitsuba has single precision.

    The floor is under twenty cubes, and turned so that none of its coordinates is exact.
    """
    tilt, cube = "ROTATE-X (7) ROTATE-Y (5)", "TRANSLATE (-.5 -.5 0) SCALE (.3 .3 .3)"
    crowd = [f"{cube} ROTATE-Z ({17 * i}) TRANSLATE ({i % 5 - 1.9} {i // 5 - 2.1} 0) {tilt}" for i in range(20)]
    text = scene(" ".join([*["+"] * 20, "PLANE 20", *(f"CUBE {i}" for i in range(20))]), [*crowd, tilt])
    local, linear = turned(text, 20)
    x, y = np.random.default_rng(0).uniform(-4, 4, (2, 500_000))
    up = np.linalg.inv(linear)
    eye = up @ [1, -2, 20]
    d = (up @ np.stack([x, y, 0 * x])).T - eye
    loaded = mi.load_dict(prosim_scene.load(write_scene(text)))
    hit = loaded.ray_intersect(mi.Ray3f(mi.Point3f(eye), mi.Vector3f(d.T)))
    through = np.array(hit.is_valid()) & (local(np.array(hit.p).T)[:, 2] < -0.01)
    assert through.mean() < 2e-5


# ---- Faces that coincide but for rounding


def turns(count, seed=1):
    """Steps of random rotations with a move."""
    rng = np.random.default_rng(seed)
    for x, y, z in rng.uniform(-180, 180, (count, 3)):
        yield f"ROTATE-X ({x}) ROTATE-Y ({y}) ROTATE-Z ({z}) TRANSLATE ({x / 90} {y / 90} {z / 90})"


HALF, BAND = "SCALE (.5 .5 .5) TRANSLATE (.25 .25 .5)", "ROTATE-Z (17) SCALE (1 1 2) TRANSLATE (0 0 4)"
POLE, SHORT = "SCALE (1 1 10)", "SCALE (1 -1 5) ROTATE-Z (31)"
#: Name -> the tree and its transforms (then comes a random turn); the areas of the meshes; their volume.
TURNED = {
    "a flush cut is open": ("- CUBE 0 CUBE 1", ["", HALF], [6 - 0.25, 5 * 0.25], 1 - 0.125),
    "touching blocks have no wall": ("+ CUBE 0 CUBE 1", ["", "TRANSLATE (1 0 0)"], [5, 5], 2),
    "blocks that touch along an edge": ("+ CUBE 0 CUBE 1", ["", "TRANSLATE (1 0 1)"], [6, 6], 2),
    "a band hides its pole": ("+ CYLINDER 0 CYLINDER 1", [BAND, POLE], [4 * math.pi, 18 * math.pi], 10 * math.pi),
    "a ring hides its copy": ("+ TORUS 0 TORUS 1", ["", "SCALE (1 -1 1) ROTATE-Z (31)"], [math.pi**2], math.pi**2 / 8),
    # of the second one there is the disc, and nothing of its side
    "a pole less a shorter one": ("- CYLINDER 0 CYLINDER 1", [POLE, SHORT], [11 * math.pi, math.pi], 5 * math.pi),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", TURNED)
def test_coincident_faces_of_turned_solids(name):
    tree, transforms, areas, expected = TURNED[name]
    near = 1e-6 if "CUBE" in tree else 5e-3
    for turn in turns(6, seed=len(name)):
        meshes = solids(scene(tree, [f"{steps} {turn}" for steps in transforms]))
        assert_closed(meshes.values())
        assert {i: area(mesh) for i, mesh in meshes.items()} == pytest.approx(dict(enumerate(areas)), rel=near)
        assert volume(list(meshes.values())) == pytest.approx(expected, rel=near), turn


@pytest.mark.parametrize("shape, height", [("CUBE", "1 1 {}"), ("SPHERE", "{} 1 1")])
def test_faces_that_count_as_one_but_differ_by_more_than_rounding_are_named(recwarn, shape, height):
    message = rf"faces of {shape} 0 \(line 3\), {shape} 1 \(line 3\) are only about (\S+) apart, so they count as one"
    for gap, named, owner in ((1e-9, False, 0), (1e-7, True, 0), (1e-5, False, 1)):
        recwarn.clear()
        meshes = solids(scene(f"+ {shape} 0 {shape} 1", ["", f"SCALE ({height.format(1 + gap)})"]), 0.3)
        found = [match for one in recwarn if (match := re.search(message, str(one.message)))]
        assert owner in meshes and bool(found) == named
        assert not named or float(found[0][1]) == pytest.approx(gap, rel=0.5)


TOUCHING = {
    "- CONE 0 SPHERE 1": ["", "TRANSLATE (0 0 1)"],
    "- CYLINDER 0 SPHERE 1": ["SCALE (.6 .6 1.6) TRANSLATE (0 0 -.8)", ""],
    "- CUBE 0 SPHERE 1": [f"TRANSLATE (-.5 -.5 -.5) SCALE ({2 / 3**0.5} {2 / 3**0.5} {2 / 3**0.5})", ""],
    "* - SPHERE 0 SPHERE 1 - SPHERE 2 SPHERE 0": ["TRANSLATE (0 0 -.1)", "", "TRANSLATE (.1 0 0)"],
    "* - SPHERE 0 SPHERE 1 - SPHERE 1 SPHERE 0": ["TRANSLATE (0 0 -.3)", "TRANSLATE (0 0 .3)"],
}


@pytest.mark.slow
@pytest.mark.parametrize("tree", TOUCHING)
@pytest.mark.parametrize("size", [1, 1.03])
def test_result_of_slivers_alone_causes_a_warning(tree, size):
    """Edges of the first solid touch the second one from inside, or stick out if they are larger."""
    first, *others = TOUCHING[tree]
    for turn in turns(3, seed=len(tree)):
        steps = [f"{own} {turn}" for own in (f"{first} SCALE ({size} {size} {size})", *others)]
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always", SceneWarning)
            meshes = solids(scene(tree, steps), 0.1)
        empty = any(re.search("result (is|may be) empty", str(one.message)) for one in found)
        assert empty == (size == 1 or not meshes)


def test_ball_less_itself_is_empty():
    for turn in turns(2, seed=10):
        with pytest.warns(SceneWarning, match="the tree's result is empty"):
            solids(scene("- SPHERE 0 SPHERE 1", ["SCALE (1 2 3)", f"{turn.split('TRANSLATE')[0]} SCALE (1 2 3)"]), 0.3)
