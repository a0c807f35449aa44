"""Scenes as text, their meshes, and what is measured on them."""

import numpy as np
from prosim_scene.geometry import TranslationCache, tessellate
from prosim_scene.language import document_of
from prosim_scene.mitsuba import assemble
from prosim_scene.view import camera_of

VIEW = "VIEW OBS 0 0 20 VRP 0 0 0 WINDOW -5 -5 5 5 RESOLUTION 500 500 LIGHTS POINT position 0 9 9"


def scene(tree, transforms, surfaces=()):
    """A scene text: TRANSFORM i for each of ``transforms``; surfaces are lambertian unless given."""
    lines = [VIEW, "CSG-TREE", tree]
    for i, transform in enumerate(transforms):
        surface = surfaces[i] if i < len(surfaces) else f"material lambertiano kd = 0.{i % 9 + 1} 0 0"
        lines += [f"SURFACE {i} {surface}", f"TRANSFORM {i} {transform}"]
    return "\n".join([*lines, "END"])


def skins(text, tolerance=0.05):
    """{MeshKey: Triangles} of a scene."""
    document = document_of(text, "test.scn")
    return tessellate(document, camera_of(document), tolerance, assemble.looks(document.scene), {}, TranslationCache())


def solids(text, tolerance=0.05):
    """{index of the first leaf with that look: Triangles} of a scene; of interfaces between dielectrics the key is
    that index and that of the first leaf of the medium outside.
    """
    looks, media = {}, {}
    scene = document_of(text, "test.scn").scene
    for leaf in scene.csg:
        if not hasattr(leaf, "symbol"):
            looks.setdefault(assemble.appearance_key(scene, leaf), leaf.index)
            media.setdefault(assemble.medium_key(scene, leaf), leaf.index)
    return {
        looks[skin.material] if skin.outside is None else (looks[skin.material], media[skin.outside]): triangles
        for skin, triangles in skins(text, tolerance).items()
    }


def volume(meshes):
    p = np.concatenate([m.positions for m in meshes])
    return np.einsum("ti,ti->", p[:, 0], np.cross(p[:, 1], p[:, 2])) / 6


def area(mesh, chosen=slice(None)):
    p = mesh.positions[chosen]
    return np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1).sum() / 2


def assert_closed(meshes):
    """Every edge, between vertices of equal position, is met once in each direction."""
    p = np.concatenate([m.positions for m in meshes])
    _, vertex = np.unique(p.reshape(-1, 3), axis=0, return_inverse=True)
    t = vertex.reshape(-1, 3)
    edges = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    forward = edges[:, 0] * (t.max() + 1) + edges[:, 1]
    backward = edges[:, 1] * (t.max() + 1) + edges[:, 0]
    assert np.array_equal(np.sort(forward), np.sort(backward))
