"""Primitives that nothing touches, whose meshes go to the result as they are."""

import numpy as np
import pytest
from meshes import VIEW, assert_closed, scene, skins, solids, volume
from prosim_scene.geometry import media, surfaces

SHAPES = ["CUBE", "SPHERE", "CYLINDER", "CONE"]
TURNED = "SCALE (1 {} 1.5) ROTATE-X (30) ROTATE-Z (200)"
MATERIALS = ["material lambertiano", "material condutor ouro", "material dieletrico n-refr = 1.5"]


def row(*more):
    """Primitives beside one another, every other one a mirror image, of three materials in turn; and more of them."""
    leaves = [(SHAPES[i % 4], f"{TURNED.format(-1 if i % 2 else 1)} TRANSLATE ({4 * i} 0 {i % 3})") for i in range(12)]
    leaves += more
    lines = [VIEW, "CSG-TREE", *["+"] * (len(leaves) - 1), *(f"{shape} {i}" for i, (shape, _) in enumerate(leaves))]
    for i, (_, transform) in enumerate(leaves):
        lines += [f"SURFACE {i} {MATERIALS[i % 3]}", f"TRANSFORM {i} {transform}"]
    return "\n".join([*lines, "END"])


def corners(mesh):
    """Positions, normals and uv of each triangle from its least corner on, sorted by these; u is 0 or 1 at the seam."""
    turn = 2 * np.pi * mesh.uv[:, :1]
    p, *others = (a[mesh.index] for a in (mesh.vertices, mesh.normals, np.cos(turn), np.sin(turn), mesh.uv[:, 1:]))
    p = p.round(9)
    first = np.lexsort(p.transpose(2, 0, 1)[::-1], axis=-1)[:, :1]
    around = ((first + np.arange(3)) % 3)[..., None]
    columns = np.concatenate([np.take_along_axis(a, around, axis=1) for a in (p, *others)], axis=2)
    return columns[np.lexsort(columns[..., :3].reshape(len(p), -1).T)]


# None; a cube in the second one, of glass and of what is opaque; one that has a flat face in common with the first
@pytest.mark.parametrize(
    "more, count",
    [((), 12), ((("CUBE", "TRANSLATE (4 0 1)"),), 11), ((("CUBE", f"TRANSLATE (-9 0 0) {TURNED.format(1)}"),), 13)],
)
def test_what_nothing_touches_is_what_an_operation_makes_of_it(monkeypatch, more, count):
    found = []
    whole = media.whole
    monkeypatch.setattr(media, "whole", lambda *a: found.append(a) or whole(*a))
    meshes = skins(row(*more), 2)
    assert len(found) == count
    monkeypatch.setattr(surfaces, "components", lambda low, high: np.zeros(len(low), int))  # all are one group
    expected = skins(row(*more), 2)
    assert len(found) == count and meshes.keys() == expected.keys()
    for skin, mesh in meshes.items():
        assert abs(len(mesh.vertices) - len(expected[skin].vertices)) < 20  # at the seam
        assert corners(mesh) == pytest.approx(corners(expected[skin]), abs=1e-6)


def test_what_stands_in_the_corner_of_an_l_touches_its_box_alone():
    # All three stand on one plane.
    transforms = ["SCALE (3 1 1)", "SCALE (1 3 1)", "SCALE (.5 .5 1) TRANSLATE (2 2 0)"]
    for tree in ("+ + CUBE 0 CUBE 1 CUBE 2", "+ CUBE 2 + CUBE 0 CUBE 1"):
        meshes = list(solids(scene(tree, transforms)).values())
        assert_closed(meshes)
        assert volume(meshes) == pytest.approx(5.25, rel=1e-12)
