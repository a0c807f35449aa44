"""A render in progress, by whatever integrator."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi

from ..engine.work import Step

#: Shows the part done, 0 to 1, of a render in progress.
Tell = Callable[[float, Any], None]


def keeps(integrator: mi.Integrator) -> bool:
    """Whether an integrator renders progressively, as ours does in all but scalar variants."""
    return hasattr(integrator, "progressive") and dr.is_jit_v(mi.Float)


def progressive(
    scene: mi.Scene, sensor: mi.Sensor, seed: int = 0, spp: int = 0, integrator: Any = None, **how: Any
) -> Any:
    """A :class:`.Render` of the scene's integrator, or another; a :class:`Blocking` where that renders as a whole.

    ``spp``: samples per pixel, 0 for as many as the scene says; ``how``: for its method ``progressive``.
    """
    integrator = integrator or scene.integrator()
    if not keeps(integrator):
        return Blocking(integrator, scene, sensor, seed, spp)
    return integrator.progressive(scene, sensor, seed, spp, **how)


class Blocking:
    """The render of an integrator that says nothing until its end: one :class:`.Step`, as :class:`.Render` has many."""

    reached = None

    def __init__(self, integrator: Any, *arguments: Any) -> None:
        self.integrator, self.arguments, self.ended = integrator, arguments, False

    def __iter__(self) -> Blocking:
        return self

    def __next__(self) -> Step:
        if self.ended:
            raise StopIteration
        self.ended = True
        scene, sensor, seed, spp = self.arguments
        # Mitsuba's own integrators in Python insist on developing the film, so all do; writing it is another step.
        self.integrator.render(scene, sensor, seed=seed, spp=spp, develop=True, evaluate=True)
        dr.sync_thread()
        return Step(1.0, True)

    def put(self) -> None:
        """The film holds the image already."""

    def close(self) -> None:
        """Does not begin any more."""
        self.ended = True
