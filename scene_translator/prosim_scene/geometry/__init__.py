"""Converts the CSG tree to triangles: makes the meshes of the primitives, transforms them, applies Boolean operations,
and computes the resulting surfaces.
"""

from .detail import TOLERANCE
from .surfaces import Look, MeshKey, TranslationCache, Triangles, tessellate

__all__ = ["TOLERANCE", "Look", "MeshKey", "TranslationCache", "Triangles", "tessellate"]
