"""The targets of a translation.

``prosim`` uses this project's plugins, ``stock`` only Mitsuba's own; each is a module with the functions of
:class:`Target`. Both use ``lights``, ``materials``, ``textures`` and ``sensor``, and the state of a translation in
``context``; ``assemble`` makes the whole scene.
"""

from typing import Protocol

from ..model import Leaf, Light
from ..nodes import Node
from ..view import Camera
from . import prosim, stock
from .context import Context
from .materials import MediumInterface


class Target(Protocol):
    """A module that translates the parts of a scene to certain plugins."""

    #: The sampler for N^2 samples a pixel.
    SAMPLER: str

    def settings(self, context: Context) -> Node:
        """The entries of the scene's dictionary for its settings: the integrator, and others."""

    def camera(self, context: Context, camera: Camera) -> Camera:
        """The nearest camera that the target has."""

    def light(self, context: Context, number: int, light: Light) -> Node:
        """An emitter, or a shape with an emitter."""

    def surface(self, context: Context, number: int, leaf: Leaf, sides: MediumInterface) -> Node:
        """The entries of a shape for the SURFACE of a leaf, node ``number`` of the tree, with the media ``sides``."""


TARGETS: dict[str, Target] = {"prosim": prosim, "stock": stock}
