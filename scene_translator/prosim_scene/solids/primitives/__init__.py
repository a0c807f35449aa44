"""The primitives of the language, one file each, found by the name that the language gives them."""

from .cone import Cone
from .cube import Cube
from .cylinder import Cylinder
from .primitive import MAX_SEGMENTS, UNSEEN_SEGMENTS, UNSEEN_TOLERANCE, Corners, Mesh, Primitive, box_corners
from .sphere import Sphere

__all__ = [
    "MAX_SEGMENTS",
    "PRIMITIVES",
    "UNSEEN_SEGMENTS",
    "UNSEEN_TOLERANCE",
    "Corners",
    "Mesh",
    "Primitive",
    "box_corners",
]

#: Every primitive by its name, which is that of :attr:`prosim_scene.model.Leaf.shape`.
PRIMITIVES: dict[str, Primitive] = {primitive.name: primitive for primitive in (Cube(), Sphere(), Cylinder(), Cone())}
