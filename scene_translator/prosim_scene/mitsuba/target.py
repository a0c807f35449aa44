"""What the modules of the targets, the plugins of this package and those of Mitsuba, define."""

from typing import Protocol

from ..model import Leaf, Light
from ..nodes import Node
from ..view import Camera
from .materials import MediumInterface
from .translation_context import Context


class Target(Protocol):
    """Translates parts of a scene to Mitsuba dictionaries."""

    #: Plugin name of the sampler.
    SAMPLER: str
    #: Plugin name of the sensor of a camera with an aperture.
    LENS: str

    def settings(self, context: Context) -> Node:
        """Returns the integrator and other settings of the scene."""

    def camera(self, context: Context, camera: Camera) -> Camera:
        """Returns the camera that the target can render."""

    def light(self, context: Context, number: int, light: Light) -> Node:
        """Returns the emitter of the ``light`` with this number."""

    def surface(self, context: Context, number: int, leaf: Leaf, sides: MediumInterface) -> Node:
        """Returns the BSDF of the surface with this number on the ``leaf``, between the media of its sides."""
