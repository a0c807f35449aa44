"""From the CSG tree to triangles: primitives, their transforms, the tree evaluated, the surfaces of the result."""

from .detail import TOLERANCE
from .kept import Kept
from .triangles import Triangles, tessellate

__all__ = ["TOLERANCE", "Kept", "Triangles", "tessellate"]
