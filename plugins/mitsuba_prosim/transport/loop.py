"""The loop over the nodes of a tree or path."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi

from .context import Context
from .vertex import end


def walk(
    context: Context, step: Callable[[Any], Any], state: Any, camera: mi.Ray3f, branches: bool = False
) -> tuple[mi.Spectrum, mi.Bool]:
    """Takes ``state`` from node to node by ``step`` and returns ``(L, hit)``, the state's fields.

    ``state``: a dataclass with at least ``L``, ``hit``, ``ray`` and ``active``; ``step`` makes the next one of it. Rays
    below the deepest level can only end in a source: where no tree ``branches``, they are traced after the loop, which
    spares all other lanes a round.
    """
    max_level, lights = context.settings.max_level, context.facts.lights
    ends = max_level >= 0 and not branches
    if ends and max_level == 0:
        state = step(state)
    else:

        def going(state: Any) -> mi.Bool:
            return state.active & (state.ray.level <= max_level) if ends else state.active

        if context.attached:
            state = differentiable_loop(state, going, step)
        else:
            (state,) = dr.while_loop((state,), going, lambda state: (step(state),))
    if ends and not lights.only_points:
        return state.L + end(context, state.ray, camera, state.active), state.hit
    return state.L, state.hit


def differentiable_loop(state: Any, going: Callable[[Any], mi.Bool], step: Callable[[Any], Any]) -> Any:
    """The last of the states that ``step`` makes of ``state``, in each lane while it is ``going``, with derivatives.

    An iteration is one kernel, and its derivative another: the same for all iterations. Dr.Jit 1.5 cannot do that: of a
    symbolic loop that has derivatives it generates wrong code for masks; and its evaluated loop goes backwards in the
    order of a hash table, so that each iteration is compiled anew.
    """
    dr.make_opaque(state)
    while dr.any(active := going(state)):
        state = dr.select(active, step(state), state)
        dr.eval(state)
        if tracked(state):
            state = with_tracked(state, iter(dr.custom(Boundary, tracked(state))))
    return state


class Boundary(dr.CustomOp):
    """The same arrays. Their derivatives are evaluated here, in the order of the arrays."""

    def eval(self, arrays: list[Any]) -> list[Any]:  # noqa: D102
        return arrays

    def forward(self) -> None:  # noqa: D102
        gradients = self.grad_in("arrays")
        dr.eval(gradients)
        self.set_grad_out(gradients)

    def backward(self) -> None:  # noqa: D102
        gradients = self.grad_out()
        dr.eval(gradients)
        self.set_grad_in("arrays", gradients)


def tracked(state: Any) -> list[Any]:
    """The arrays in dataclasses and lists that have derivatives."""
    if is_dataclass(state):
        state = [getattr(state, field.name) for field in fields(state)]
    if isinstance(state, list):
        return [array for part in state for array in tracked(part)]
    return [state] if isinstance(state, dr.ArrayBase) and dr.grad_enabled(state) else []


def with_tracked(state: Any, arrays: Iterator[Any]) -> Any:
    """``state`` with ``arrays`` in the place of those that are :func:`tracked`."""
    if is_dataclass(state) and not isinstance(state, type):
        return replace(state, **{f.name: with_tracked(getattr(state, f.name), arrays) for f in fields(state)})
    if isinstance(state, list):
        return [with_tracked(part, arrays) for part in state]
    return next(arrays) if tracked(state) else state
