"""Warns if the eye, or a light, is inside an opaque solid, or a light in a closed hollow of one."""

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from manifold3d import Manifold, Mesh64
from numpy.typing import ArrayLike

from ..language.document import Document, Path
from .csg import Tree, fold
from .leaves import Leaves
from .solids import world_boxes

#: Directions from the centre of a spherical light to its tested points: to the faces and the corners of a cube.
DIRECTIONS = np.concatenate([np.eye(3), -np.eye(3), np.indices((2, 2, 2)).reshape(3, 8).T * 2 / 3**0.5 - 1 / 3**0.5])


def warn_of_enclosure(
    document: Document, tree: Tree, table: Leaves, opaque: Sequence[bool], boundary: Callable[[], np.ndarray]
) -> None:
    """Warns of the eye and of each light, or part of one, in an opaque solid, and of each light in a closed hollow.

    ``opaque`` is for each leaf; ``boundary`` returns the triangles (n, 3, 3) of all opaque solids.
    """
    low, high = world_boxes(table.solids)
    numbers = [number for number, _ in document.scene.leaves]
    around_eye = np.zeros(len(low), bool)
    hollow: list[tuple[Path, str, np.ndarray]] = []  # lights, each in a solid in which the eye is not
    for path, name, world_points in _places(document):
        points = world_points - table.origin
        inside = np.zeros((len(low), len(points)), bool)
        for solid in np.flatnonzero(((low <= points.max(axis=0)) & (high >= points.min(axis=0))).all(axis=1)).tolist():
            mesh = table.solids[solid].mesh()
            inside[solid] = [_contains(mesh.vertices, mesh.triangles, point) for point in points]
        owner = _opaque_owner(tree, inside[table.of_leaf], opaque) if inside.any() else np.array([-1])
        if (owner >= 0).any():
            number = numbers[int(owner.max())]
            part = "" if (owner >= 0).all() else "a part of "
            solid_name = document.name_of(number, whole=True)
            reason = f"{part}{name} is inside {solid_name} (line {document.line('csg', number)}), which is opaque"
            document.warn(f"{reason}; move it out of the solid", *path)
        elif path == ("view", "eye"):
            around_eye = inside[:, 0]
        elif document.scene.shadows and (inside.all(axis=1) & ~around_eye).any():
            hollow.append((path, name, world_points[0]))
    walls = _parts(boundary()) if hollow else []
    meshes = [(mesh.vert_properties, mesh.tri_verts) for mesh in (wall.to_mesh64() for wall in walls)]
    for path, name, point in hollow:
        for vertices, triangles in meshes:
            around = [_contains(vertices, triangles[:, ::-1], one) for one in (point, document.scene.view.eye)]
            if around == [True, False]:
                reason = f"{name} is in a closed hollow of an opaque solid, which keeps its light from the eye"
                document.warn(f"{reason}; open the solid, or move the light", *path)
                break


def _parts(triangles: np.ndarray) -> list[Manifold]:
    """Returns the connected parts of a closed surface; none if it is not a manifold."""
    vertices, index = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    return list(Manifold(Mesh64(vertices, index.reshape(-1, 3).astype(np.uint64))).decompose())


def _places(document: Document) -> Iterator[tuple[Path, str, np.ndarray]]:
    yield ("view", "eye"), "the eye", np.array([document.scene.view.eye])
    for i, light in enumerate(document.scene.lights):
        if light.kind != "sky":
            # The sphere is slightly smaller, because a light may touch a solid.
            sphere = np.array(light.position) + 0.999 * light.radius * DIRECTIONS
            name = f"the light on line {document.line('lights', i)}"
            yield ("lights", i), name, sphere if light.kind == "area" else np.array([light.position])


def _opaque_owner(tree: Tree, inside: np.ndarray, opaque: Sequence[bool]) -> np.ndarray:
    """Returns, for each point, the leaf whose opaque solid contains the point in the result of the CSG tree, or -1."""

    def combine(symbol: str, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        (owner, contained), (other_owner, other) = first, second
        if symbol == "+":
            return np.stack([np.where(owner >= 0, owner, other_owner), contained | other])
        kept = other if symbol == "*" else 1 - other
        return np.stack([np.where(kept, owner, -1), contained & kept])

    return np.asarray(
        fold(tree, lambda i: np.stack([np.where(inside[i] & opaque[i], i, -1), inside[i].astype(int)]), combine)[0]
    )


def _contains(vertices: np.ndarray, triangles: np.ndarray, point: ArrayLike) -> bool:
    """Whether a closed mesh contains a point: its triangles then have the solid angle 4 pi from there."""
    corners = vertices - np.asarray(point)
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", x, y) for x, y in ((a, b), (b, c), (c, a)))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    return bool(np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb).sum() > math.pi)
