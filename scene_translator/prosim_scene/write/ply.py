"""Triangles -> binary PLY."""

import numpy as np

from ..solids import Triangles


def ply(triangles: Triangles, with_uv: bool) -> bytes | None:
    """The bytes of a PLY file; equal corners become one vertex.

    Triangles without area in single precision are left out; None where no others are.
    """
    positions = triangles.positions.astype("<f4")
    a, b, c = (positions[:, i] for i in range(3))
    kept = (a != b).any(1) & (b != c).any(1) & (c != a).any(1)
    if not kept.any():
        return None
    _, first, index = np.unique(triangles.keys[kept], return_index=True, return_inverse=True)
    columns = [positions[kept].reshape(-1, 3)[first], triangles.normals[kept].reshape(-1, 3)[first]]
    names = ["x", "y", "z", "nx", "ny", "nz"]
    if with_uv:
        columns.append(triangles.uv[kept].reshape(-1, 2)[first])
        names += ["u", "v"]
    vertices = np.concatenate(columns, axis=1).astype("<f4")
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
