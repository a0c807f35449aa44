"""A progressive render of any integrator."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..engine.work import Step


def is_progressive(integrator: mi.Integrator) -> bool:
    """Whether an integrator renders progressively, as ours does in all but scalar variants."""
    return hasattr(integrator, "progressive") and dr.is_jit_v(mi.Float)


def progressive(
    scene: mi.Scene, sensor: mi.Sensor, seed: int = 0, spp: int = 0, integrator: Any = None, **how: Any
) -> Any:
    """A :class:`.Render` of the scene's integrator, or of another; a :class:`Blocking` where that is not progressive.

    ``spp``: samples per pixel, 0 for those of the scene; ``how``: for the method ``progressive``.
    """
    integrator = integrator or scene.integrator()
    if not is_progressive(integrator):
        return Blocking(integrator, scene, sensor, seed, spp)
    return integrator.progressive(scene, sensor, seed, spp, **how)


class Blocking:
    """The interface of :class:`.Render` for an integrator that renders the whole image in one :class:`.Step`."""

    reached = None

    def __init__(self, integrator: Any, scene: mi.Scene, sensor: mi.Sensor, seed: int, spp: int) -> None:
        self.steps = self._render(integrator, scene, sensor, seed, spp)
        self.close = self.steps.close

    def __iter__(self) -> Blocking:
        return self

    def __next__(self) -> Step:
        return next(self.steps)

    def _render(self, integrator: Any, scene: mi.Scene, sensor: mi.Sensor, seed: int, spp: int) -> Any:
        # Mitsuba's integrators in Python always develop the film. Writing it is another step.
        integrator.render(scene, sensor, seed=seed, spp=spp, develop=True, evaluate=True)
        dr.sync_thread()
        yield Step(1.0, True)

    def update_film(self) -> None:
        """Does nothing, as the film already holds the image."""
