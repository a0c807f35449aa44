"""What the geometry wants to know of the camera."""

from typing import Protocol

import numpy as np


class Sight(Protocol):
    """A camera, as far as it decides how fine is fine enough."""

    @property
    def eye(self) -> np.ndarray:
        """Where it stands (3,)."""

    def footprint(self, distance: np.ndarray | float) -> np.ndarray:
        """Length that a pixel covers at a distance from the eye."""

    def may_see(self, corners: np.ndarray) -> np.ndarray:
        """Whether the convex hull of points (..., n, 3) may reach into the picture."""
