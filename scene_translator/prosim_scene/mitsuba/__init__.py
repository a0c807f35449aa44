"""What a scene is translated for: the functions that a target has.

``prosim`` is for this project's plugins, ``stock`` for those alone that Mitsuba brings; each is a module with the
functions of :class:`Target`. What they share lies beside them: ``lights``, ``materials``, ``textures`` and ``sensor``,
and what they know of the translation in ``context``; ``assemble`` puts all of it together.
"""

from typing import Protocol

from ..camera import Camera
from ..model import Leaf, Light
from ..nodes import Node
from . import prosim, stock
from .context import Context
from .materials import MediumInterface


class Target(Protocol):
    """A module that says a scene in the words of certain plugins."""

    #: The sampler for N^2 samples a pixel.
    SAMPLER: str

    def settings(self, context: Context) -> Node:
        """The integrator and what else stands for the settings of the whole scene, by their keys in its dictionary."""

    def camera(self, context: Context, camera: Camera) -> Camera:
        """The camera that the target can say."""

    def light(self, context: Context, number: int, light: Light) -> Node:
        """An emitter, or the shape that bears it."""

    def surface(self, context: Context, number: int, leaf: Leaf, sides: MediumInterface) -> Node:
        """The entries of a shape that give it the look of a leaf, node ``number`` of the tree. ``sides`` are the media
        on both sides.
        """


TARGETS: dict[str, Target] = {"prosim": prosim, "stock": stock}
