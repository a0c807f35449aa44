"""The loop over the nodes of a tree or path."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi

from .node import end
from .stage import Stage


def walk(
    stage: Stage, step: Callable[[Any], Any], state: Any, camera: mi.Ray3f, branches: bool = False
) -> tuple[mi.Spectrum, mi.Bool]:
    """Takes ``state`` from node to node by ``step`` and returns ``(L, hit)``, the state's fields.

    ``state``: a dataclass with at least ``L``, ``hit``, ``ray`` and ``active``; ``step`` makes the next one of it. Rays
    below the deepest level can only end in a source: where no tree ``branches``, they are traced after the loop, which
    spares all other lanes a round.
    """
    max_level, lights = stage.settings.max_level, stage.facts.lights
    ends = max_level >= 0 and not branches
    if ends and max_level == 0:
        state = step(state)
    else:
        # A symbolic loop cannot be differentiated backwards, unless it is told how far it may go; Dr.Jit 1.5 then
        # generates wrong code for masks. Mitsuba's own integrators unroll theirs for the same reason.
        (state,) = dr.while_loop(
            (state,),
            lambda state: state.active & (state.ray.level <= max_level) if ends else state.active,
            lambda state: (step(state),),
            mode="evaluated" if stage.attached else None,
        )
    if ends and not lights.only_points:
        return state.L + end(stage, state.ray, camera, state.active), state.hit
    return state.L, state.hit
