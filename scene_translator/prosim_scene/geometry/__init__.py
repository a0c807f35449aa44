"""Converts the CSG tree to triangles: makes the meshes of the primitives, transforms them, applies Boolean operations,
and computes the resulting surfaces.
"""

from .detail import TOLERANCE
from .surfaces import MeshKey, SurfaceMesh, Triangles, tessellate

__all__ = ["TOLERANCE", "MeshKey", "SurfaceMesh", "Triangles", "tessellate"]
