"""Radiance along a camera ray: by Whitted's tree (sections 4.1, 4.2) or Kajiya's paths (section 4.2.3)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mitsuba as mi

from ..sampling.sobol import Points
from . import path, tree
from .context import Context, SceneFacts, Settings

#: Diffuse reflections of paths without end.
ANY = (1 << 31) - 1


class Transport:
    """Estimates radiance in ``scene`` under ``settings``; made once a render.

    ``attached``: whether derivatives are wanted. Directions are then fixed, or move with a source
    (:mod:`.reparameterised`), and their weights are evaluated again. ``around``: the medium of the camera.
    ``caustics``: gathers the light that reaches diffuse surfaces through specular ones, instead of the rays
    (:mod:`..photons`).
    """

    def __init__(
        self,
        settings: Settings,
        scene: mi.Scene,
        attached: bool = False,
        around: mi.Medium | None = None,
        caustics: Any | None = None,
    ) -> None:
        if caustics is not None and settings.diffuse_bounces < 0:
            # A path must know its diffuse reflections from the others, which a ray drawn from the whole BRDF does not.
            settings = replace(settings, diffuse_bounces=ANY)
        #: The photons that must have been drawn before samples are taken.
        self.caustics = caustics
        facts = SceneFacts.of(scene, settings, around)
        self._context = Context(scene, settings, facts, attached, around, caustics)
        self._radiance = tree.radiance if settings.follows_tree else path.radiance

    def __call__(
        self, ray: mi.Ray3f, points: Points, active: mi.Bool, sampler: mi.Sampler | None = None
    ) -> tuple[mi.Spectrum, mi.Bool]:
        """Radiance of the camera ray ``ray``: ``(L, hit)``, a ``mi.Spectrum`` and whether the ray met a surface.

        ``points(space, active)`` gives a ``mi.Point2f`` in [0, 1)² for a space of the sampling pattern, and
        ``points.choice(space)`` a number; ``sampler`` is the state behind them, if there is one that loops have to
        carry.
        """
        return self._radiance(self._context, ray, points, active, sampler)
