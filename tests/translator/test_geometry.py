"""Solids: volumes and areas against closed forms, closedness, normals, and who owns a face."""

import math
import random
import warnings

import numpy as np
import prosim_scene
import pytest
from meshes import area, assert_closed, scene, solids, volume
from prosim_scene import SceneWarning
from prosim_scene.geometry import csg, surfaces
from prosim_scene.geometry.coincidence import Planes
from prosim_scene.geometry.primitives import PRIMITIVES as SHAPES
from prosim_scene.geometry.primitives import Corners, Mesh, Primitive
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
    meshes = list(
        solids(
            scene(f"{shape} 0", [f"SCALE {scale} ROTATE-X (37) ROTATE-Z (-80) TRANSLATE (1 2 -1)".replace(",", "")]),
            tolerance=0.001,
        ).values()
    )
    assert_closed(meshes)
    expected, surface = PRIMITIVES[shape]
    assert volume(meshes) == pytest.approx(expected * abs(np.prod(scale)), rel=1e-4)
    if scale[0] ** 2 == 1 and scale[1] == 1:
        assert sum(map(area, meshes)) == pytest.approx(surface, rel=1e-4)


def test_sphere_cut_by_a_box():
    # The half of the unit ball with z > 0.3, cut again at x > 0: half a cap of height 0.7.
    meshes = solids(scene("* SPHERE 0 CUBE 1", ["", "SCALE (4 8 4) TRANSLATE (0 -4 0.3)"]), tolerance=0.006)
    h = 0.7
    assert_closed(list(meshes.values()))
    assert volume(list(meshes.values())) == pytest.approx(math.pi * h * h * (3 - h) / 6, rel=5e-4)
    assert area(meshes[0]) == pytest.approx(math.pi * h, rel=5e-4)  # Archimedes: half of 2 pi r h


def test_cylinder_through_a_cube():
    meshes = solids(
        scene("- CUBE 0 CYLINDER 1", ["TRANSLATE (-.5 -.5 -.5)", "SCALE (.3 .3 3) TRANSLATE (0 0 -1)"]), tolerance=0.002
    )
    assert_closed(list(meshes.values()))
    assert volume(list(meshes.values())) == pytest.approx(1 - math.pi * 0.09, rel=2e-4)
    assert area(meshes[1]) == pytest.approx(2 * math.pi * 0.3, rel=2e-4)  # the wall of the hole is the cylinder's
    assert area(meshes[0]) == pytest.approx(6 - 2 * math.pi * 0.09, rel=2e-4)
    # The hole's normals point into it, that is, to the axis.
    mesh = meshes[1]
    assert np.all(np.einsum("tci,tci->tc", mesh.normals[mesh.index], mesh.positions * [1, 1, 0]) < 0)


def test_normals_are_those_of_the_quadric_after_cuts():
    transforms = [
        "SCALE (2 1 1.5) ROTATE-Y (30)",
        "SCALE (.4 .7 6) ROTATE-X (50) TRANSLATE (0 2 -2)",
        "SCALE (1.5 1.5 3) ROTATE-Z (20) TRANSLATE (-2 0 -1)",
        "TRANSLATE (.5 -.5 -.5)",
    ]
    text = scene("- - + SPHERE 0 CONE 2 CYLINDER 1 CUBE 3", transforms)
    parsed = prosim_scene.parse(text)
    gradients = {0: lambda p: p, 1: lambda p: p * [1, 1, 0], 2: lambda p: p * [1, 1, -1]}
    meshes = solids(text)
    assert set(meshes) == {0, 1, 2, 3}
    assert_closed(list(meshes.values()))
    for index, mesh in meshes.items():
        to_local = np.linalg.inv(matrix(parsed.transforms[index]))
        p = mesh.positions @ to_local[:3, :3].T + to_local[:3, 3]
        if index == 3:
            center = p.mean(axis=1)
            face = np.argmin(np.concatenate([center, 1 - center], axis=1), axis=1)
            local = np.repeat(np.concatenate([-np.eye(3), np.eye(3)])[face][:, None], 3, axis=1)
        else:
            local = gradients[index](p)
            flat = {1: [0, 1], 2: [1]}.get(index, [])
            for z in flat:
                cap = np.all(np.abs(p[..., 2] - z) < 1e-6, axis=1)
                local[cap] = [0, 0, 1 if z else -1]
        expected = local @ to_local[:3, :3]
        if index in (1, 3):
            expected = -expected  # taken away: what was inside is now outside
        apex = np.linalg.norm(p, axis=2) < 1e-6 if index == 2 else np.zeros(p.shape[:2], bool)
        expected /= np.where(apex, 1, np.linalg.norm(expected, axis=2))[..., None]
        cosine = np.einsum("tci,tci->tc", mesh.normals[mesh.index], expected)[~apex]
        assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 0.1
        # and the triangles are wound to the same side
        p = mesh.positions
        n = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        size = np.linalg.norm(n, axis=1)
        large = size > 1e-8
        assert np.all(np.einsum("ti,ti->t", n, mesh.normals[mesh.index].mean(axis=1))[large] > 0)


def test_chord_error_is_below_the_tolerance():
    text = scene("SPHERE 0", ["SCALE (3 1 1)"])
    camera = camera_of(document_of(text))
    for tolerance in (0.5, 0.05):
        p = solids(text, tolerance)[0].positions / [3, 1, 1]
        n = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        distance = np.abs(np.einsum("ti,ti->t", n / np.linalg.norm(n, axis=1, keepdims=True), p[:, 0]))
        assert 3 * (1 - distance.min()) <= tolerance * camera.footprint(20 - 1) * 1.02


@pytest.mark.parametrize("tree, owner", [("+ CUBE 0 CUBE 1", 0), ("+ CUBE 1 CUBE 0", 1)])
@pytest.mark.parametrize("along", range(3))
def test_coincident_faces_go_to_the_first_primitive_in_the_tree(tree, owner, along):
    # Two boxes side by side: four pairs of faces lie in common planes and overlap by half.
    meshes = solids(scene(tree, ["", f"TRANSLATE ({' '.join('.5' if i == along else '0' for i in range(3))})"]))
    assert_closed(list(meshes.values()))
    for axis in {0, 1, 2} - {along}:
        for side in (0, 1):
            face = {i: area(m, np.all(np.abs(m.positions[..., axis] - side) < 1e-9, axis=1)) for i, m in meshes.items()}
            assert face[owner] == pytest.approx(1) and face[1 - owner] == pytest.approx(0.5)


def test_coincident_faces_in_a_large_union():
    # A row of boxes in shuffled order, each overlapping the next with coplanar tops, beside bodies that share no face.
    order = list(range(24))
    random.Random(4).shuffle(order)
    transforms = [f"SCALE (1.5 1 1) TRANSLATE ({i} 0 0)" for i in range(24)] + [
        f"SCALE (.3 .3 .3) TRANSLATE ({i + 0.2} .9 {0.2 + i * 0.01})" for i in range(24)
    ]
    leaves = [f"CUBE {i} SPHERE {24 + i}" for i in order]
    surfaces = [f"material lambertiano kd = 0 {i / 100} 0" for i in range(48)]
    meshes = solids(scene("+ " * 47 + " ".join(leaves), transforms, surfaces), 0.5)
    assert_closed(list(meshes.values()))
    rank = {i: n for n, i in enumerate(order)}
    for axis, at in ((1, 0), (2, 1)):  # two faces that no ball reaches
        face = {
            i: area(m, np.all(np.abs(m.positions[..., axis] - at) < 1e-9, axis=1)) for i, m in meshes.items() if i < 24
        }
        for i in range(24):
            lost = sum(0.5 for other in (i - 1, i + 1) if other in rank and rank[other] < rank[i])
            assert face[i] == pytest.approx(1.5 - lost)


def test_dielectrics_give_way_to_opaque_solids():
    glass = "material dieletrico n-refr = 1.5"
    text = scene(
        "+ CUBE 0 SPHERE 1", ["TRANSLATE (-.5 -1 -.5)", "SCALE (.4 .4 .4)"], ["material lambertiano kd = .5", glass]
    )
    meshes = solids(text, 0.005)
    # The opaque box keeps its whole surface: the ray inside the glass meets it.
    assert_closed([meshes[0]])
    assert volume([meshes[0]]) == pytest.approx(1)
    # Of the ball there is the upper half; its shell is closed by the box's top.
    assert area(meshes[1]) == pytest.approx(2 * math.pi * 0.16, rel=1e-3)
    unshared = solids(scene("- SPHERE 0 CUBE 1", ["", "TRANSLATE (-.5 -.5 0) SCALE (4 4 4)"], [glass, glass]), 0.005)
    assert_closed(list(unshared.values()))
    assert len(unshared) == 1


def test_two_glasses_have_one_interface():
    surfaces = ["material dieletrico n-refr = 1.5", "material dieletrico n-refr = 1.33"]
    meshes = solids(scene("+ CUBE 0 CUBE 1", ["", "TRANSLATE (.5 0 0)"], surfaces))
    assert_closed([meshes[0], meshes[0, 1]])
    assert area(meshes[0]) == pytest.approx(5) and area(meshes[0, 1]) == pytest.approx(1)
    assert area(meshes[1]) == pytest.approx(4 * 0.5 + 1) and len(meshes) == 3


def test_a_cut_face_belongs_to_the_cutter_whatever_it_is_made_of():
    surfaces = ["material dieletrico n-refr = 1.5"] + 2 * ["material lambertiano kd = .5"]
    meshes = solids(
        scene("- SPHERE 0 + CUBE 1 CUBE 2", ["", "SCALE (4 4 4)", "SCALE (4 4 4) TRANSLATE (0 -4 0)"], surfaces)
    )
    assert_closed(list(meshes.values()))
    assert area(meshes[1]) == pytest.approx(
        2 * math.pi / 2, rel=1e-3
    )  # a quarter of the ball is gone; half discs remain


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


@pytest.mark.parametrize(
    "tree", [["+"] * 1200 + [0] * 1201, ["+", 0] * 1200 + [0], ["*", 0] + ["+", 0] * 300 + [0], ["-", 0] * 1200 + [0]]
)
def test_depth_of_nesting_needs_no_recursion(tree):
    mesh = surfaces.manifold(SHAPES["cube"].mesh(4, np.eye(4)), 0, 0)
    planes = Planes(np.empty((0, 4)), np.empty(0, int), np.full(6, -1), np.ones(6), 1e-9)
    body = csg.Body(mesh, np.array([[[0.0] * 3, [1.0] * 3]]), frozenset(), planes, 0)
    assert csg.evaluate(tree, [0], lambda _: body)[0].manifold.volume() == pytest.approx(1)


class Bracket(Primitive):
    """An L in the xy plane, 1 high, which is not convex, and of whose surfaces nothing is known."""

    name = "bracket"
    quadrics = np.empty((0, 4, 4))
    box = np.array([[0.0, 0, 0], [2, 2, 1]])

    def mesh(self, segments, frame):
        outline = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]])
        vertices = np.concatenate([np.insert(outline, 2, z, axis=1) for z in (0.0, 1.0)])
        top = np.array([[6, 7, 9], [7, 8, 9], [6, 9, 11], [9, 10, 11]])
        sides = [t for i in range(6) for j in [(i + 1) % 6] for t in ((i, j, j + 6), (i, j + 6, i + 6))]
        triangles = np.concatenate([top, top[:, ::-1] - 6, sides])
        return Mesh(vertices, triangles, np.arange(len(triangles)), np.zeros(len(triangles), int))

    def count(self, segments):
        return 20

    def corners(self, p, face):
        normals = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        return Corners(np.repeat(normals[:, None], 3, axis=1), p[..., :2], np.ones(p.shape[:2], bool))


@pytest.mark.parametrize(
    "tree, expected",
    [("SPHERE 0", 3), ("- SPHERE 0 CUBE 1", 3 - 0.2), ("+ CUBE 1 SPHERE 0", 3.8), ("* SPHERE 0 CUBE 1", 0.2)],
)
def test_a_primitive_may_be_any_closed_mesh(monkeypatch, tree, expected):
    monkeypatch.setitem(SHAPES, "sphere", Bracket())
    meshes = solids(scene(tree, ["ROTATE-Z (30)", "TRANSLATE (.8 -.5 .6) ROTATE-Z (30)"]))
    assert_closed(meshes.values())
    assert volume(list(meshes.values())) == pytest.approx(expected, rel=1e-9)


def test_a_solid_that_vanishes_by_an_operator_between_its_operands_is_told_of_the_order(tmp_path):
    """The tree is valid, but means something else than + + + A (B * C)."""
    path = tmp_path / "s.scn"
    path.write_text(
        "LIGHTS POINT position 0 9 9\nCSG-TREE + + +\nCYLINDER 1\n- CYLINDER 2 *\nCONE 3\nCYLINDER 4\n"
        "SPHERE 5 SPHERE 6\n"
        + "".join(f"SURFACE {i}\nTRANSFORM {i} TRANSLATE ({5 * i} 0 0)\n" for i in range(1, 7))
        + "END\n"
    )
    expected = (
        r"nothing is visible of CONE 3 \(line 5\), CYLINDER 4 \(line 6\): .*operators come before their operands: "
        r"\* \(line 4\) has the operands CONE 3 \(line 5\) and CYLINDER 4 \(line 6\)"
    )
    with pytest.warns(SceneWarning, match=expected) as warned:
        prosim_scene.check(path)
    assert len(warned) == 1
