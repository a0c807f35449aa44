"""Triangles -> binary PLY."""

import numpy as np

from ..solids import Triangles


def ply(triangles: Triangles, with_uv: bool) -> bytes | None:
    """The bytes of a PLY file.

    Triangles without area in single precision are left out; None where no others are.
    """
    vertices, index = triangles.vertices.astype("<f4"), triangles.index
    a, b, c = (vertices[index[:, i]] for i in range(3))
    kept = (a != b).any(1) & (b != c).any(1) & (c != a).any(1)
    if not kept.any():
        return None
    columns = [vertices, triangles.normals]
    names = ["x", "y", "z", "nx", "ny", "nz"]
    if with_uv:
        columns.append(triangles.uv)
        names += ["u", "v"]
    vertices = np.concatenate(columns, axis=1).astype("<f4")
    if not kept.all():
        used, index = np.unique(index[kept], return_inverse=True)
        vertices = vertices[used]
    faces = np.empty(int(kept.sum()), dtype=[("count", "u1"), ("index", "<i4", 3)])
    faces["count"], faces["index"] = 3, index.reshape(-1, 3)
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(vertices)}",
        *(f"property float {name}" for name in names),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
        "",
    ]
    return "\n".join(header).encode() + vertices.tobytes() + faces.tobytes()
