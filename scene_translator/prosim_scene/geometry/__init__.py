"""From the CSG tree to triangles: primitives, their transforms, the tree evaluated, the surfaces of the result."""

from .detail import TOLERANCE
from .surfaces import MeshKey, SurfaceMesh, Triangles, tessellate

__all__ = ["TOLERANCE", "MeshKey", "SurfaceMesh", "Triangles", "tessellate"]
