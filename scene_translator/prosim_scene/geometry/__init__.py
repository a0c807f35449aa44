"""Converts the CSG tree to triangles: meshes of primitives, transforms, Boolean operations, and the resulting
surfaces.
"""

from .detail import TOLERANCE
from .surfaces import MeshKey, SurfaceMesh, Triangles, tessellate

__all__ = ["TOLERANCE", "MeshKey", "SurfaceMesh", "Triangles", "tessellate"]
