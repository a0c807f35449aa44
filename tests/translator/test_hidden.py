"""What later solids cover."""

import numpy as np
import pytest
from prosim_scene.solids.hidden import Extent, covered
from prosim_scene.solids.primitives import PRIMITIVES
from prosim_scene.solids.solid import Solid

BOX = np.array([[-1.0] * 3, [1.0] * 3])


def test_what_is_covered_lies_in_later_solids_that_are_not():
    rng = np.random.default_rng(1)
    extents = []
    for _ in range(300):
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        linear = turn / rng.uniform(0.2, 1, 3)[:, None]
        extents.append(Extent(np.append(linear, linear @ rng.uniform(-0.3, 0.3, (3, 1)), axis=1), BOX, BOX))
    gone = covered(extents, 1e-3)
    assert gone.sum() > 100 and not gone[-1]
    for k in np.flatnonzero(gone):
        own = extents[k].to_local
        corners = np.sign(rng.uniform(-1, 1, (50, 3))) * (1 + 1e-3 * np.linalg.norm(own[:, :3], axis=1))
        points = np.linalg.solve(own[:, :3], (np.append(corners, rng.uniform(-1, 1, (50, 3)), axis=0) - own[:, 3]).T).T
        later = [e.to_local for e, out in zip(extents[k + 1 :], gone[k + 1 :]) if not out]
        assert np.any([np.abs(points @ m[:, :3].T + m[:, 3]).max(axis=1) <= 1 for m in later], axis=0).all()


@pytest.mark.parametrize("shape", PRIMITIVES)
def test_the_core_of_a_solid_lies_in_its_mesh(shape):
    solid = Solid(PRIMITIVES[shape], np.eye(4), 16, shrink=1.0 if shape == "cube" else 0.9)
    mesh = solid.own_mesh()
    scale = np.where(np.arange(3) < solid.primitive.axes, solid.shrink, 1)
    a, b, c = (scale * mesh.vertices[mesh.triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    normals *= np.sign(np.einsum("ij,ij->i", normals, a - (scale * mesh.vertices).mean(axis=0)))[:, None]
    corners = np.array([[solid.core[i, 0], solid.core[j, 1], solid.core[k, 2]] for i, j, k in np.ndindex(2, 2, 2)])
    assert (np.einsum("ij,ikj->ik", normals, corners - a[:, None]) <= 1e-12).all()
    assert np.prod(solid.core[1] - solid.core[0]) > 0.1
