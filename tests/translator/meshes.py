"""Scenes as text, their meshes, and what is measured on them."""

import numpy as np
import prosim_scene
from prosim_scene.geometry import TranslationCache, tessellate
from prosim_scene.geometry.solids import matrices
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


def skins(text, tolerance=0.05, files=None):
    """{MeshKey: Triangles} of a scene, whose mesh files are the solids ``files``."""
    document = document_of(text, "test.scn")
    return tessellate(
        document, camera_of(document), tolerance, assemble.looks(document.scene), files or {}, TranslationCache()
    )


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


def turned(text, index=0):
    """A function from points to the space of TRANSFORM 0, or of another one, and the linear part of its matrix."""
    to_local = np.linalg.inv(matrices([prosim_scene.parse(text).transforms[index]])[0])
    return lambda p: p @ to_local[:3, :3].T + to_local[:3, 3], to_local[:3, :3]


def curved_face(shape, p):
    """Values and gradients of a function that is 0 on the curved face of a primitive, at points in its own space."""
    name, radius = shape.split()[0], float(shape.split("radius")[1]) if "radius" in shape else 0.25
    if name != "TORUS" and "radius" not in shape:
        form = np.array({"SPHERE": (1, 1, 1), "CYLINDER": (1, 1, 0), "CONE": (1, 1, -1)}[name])
        return p**2 @ form - (name != "CONE"), 2 * p * form
    rho = np.linalg.norm(p[..., :2], axis=-1, keepdims=True)
    if name == "CONE":
        value, gradient = rho - radius - (1 - radius) * p[..., 2:], (p[..., :2] / rho, np.full(rho.shape, radius - 1))
        return value[..., 0], np.concatenate(gradient, axis=-1)
    around = np.hypot(rho - 1, p[..., 2:])
    return (around - radius)[..., 0], np.concatenate([p[..., :2] * (1 - 1 / rho), p[..., 2:]], axis=-1) / around


def is_side(shape, p):
    """Which triangles (n, 3, 3) lie on the curved face, and not on a disc."""
    return np.ptp(p[..., 2], axis=1) > 1e-6 if shape[:2] in ("CO", "CY") else np.ones(len(p), bool)
