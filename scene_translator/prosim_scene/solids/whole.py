"""Primitives that nothing touches: their own meshes are what is left of them.

Most of these are another one's at another place. What such meshes have in common, which corners are equal and their
normals and surface parameters in the primitive's own space, is computed once.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from .faces import Piece, Triangles, corner_keys, heights
from .grouping import alike
from .leaves import Leaves
from .parts import boxes
from .placing import chunks
from .sweep import components
from .values import Value


def told_apart(value: Value) -> tuple[list[int], Value]:
    """The leaves that nothing touches, whatever its medium, and the value without them."""
    parts = [part for some in value.values() for part in some]
    group = components(*boxes(parts))
    alone = np.bincount(group, minlength=len(parts))[group] == 1
    whole = {part: part.leaf for part, by_itself in zip(parts, alone.tolist()) if by_itself and part.leaf is not None}
    rest = {medium: [part for part in some if part not in whole] for medium, some in value.items()}
    return list(whole.values()), rest


def pieces(table: Leaves, leaves: Sequence[int], kinds: Sequence[int]) -> Iterator[Piece]:
    """The triangles of leaves of the tree, each of one kind; after :meth:`Leaves.make_meshes`."""
    solids = table.of_leaf[list(leaves)].tolist()
    for numbers in alike(id(table.meshes[solid].triangles) for solid in solids).values():
        first = table.solids[solids[numbers[0]]]
        mesh, own = table.meshes[solids[numbers[0]]], first.own_mesh()
        face = own.faces[own.facets]
        found = first.primitive.corners(own.vertices[mesh.triangles], face)
        keys = corner_keys(mesh.triangles, face, found.uv, found.alone)
        _, chosen, index = np.unique(keys, return_index=True, return_inverse=True)
        vertex, index = mesh.triangles.ravel()[chosen], index.reshape(-1, 3)
        normals, uv = found.normals.reshape(-1, 3)[chosen], found.uv.reshape(-1, 2)[chosen]
        for chunk in chunks(numbers, len(index)):
            at = [solids[i] for i in chunk]
            each = np.arange(len(chunk))[:, None, None]
            vertices = np.array([table.meshes[solid].vertices for solid in at])
            high = heights(vertices.reshape(-1, 3), (mesh.triangles + each * vertices.shape[1]).reshape(-1, 3))
            triangles = Triangles(
                (vertices[:, vertex] + table.origin).reshape(-1, 3),
                table.outwards(normals, np.array(at)).reshape(-1, 3),
                np.tile(uv, (len(chunk), 1)),
                (index + each * len(vertex)).reshape(-1, 3),
            )
            kind = np.array([kinds[i] for i in chunk])
            yield Piece(
                triangles, np.repeat(kind, len(index)), np.repeat(kind, len(vertex)), high > 2 * table.planes.step
            )
