"""From the CSG tree to triangles: primitives, their transforms, the tree evaluated, the surfaces of the result."""

from .detail import TOLERANCE
from .surfaces import Faces, Skin, Triangles, tessellate

__all__ = ["TOLERANCE", "Faces", "Skin", "Triangles", "tessellate"]
