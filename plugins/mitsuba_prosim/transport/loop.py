"""The loop over the nodes of a tree or path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from .context import Context
from .layers import Radiance
from .vertex import last_emission


def walk(
    context: Context, step: Callable[[Any], Any], state: Any, camera: mi.Ray3f, branches: bool = False
) -> tuple[Radiance, mi.Bool]:
    """``(L, hit)`` of the last of the states that ``step`` makes of ``state``, from node to node.

    ``state``: a dataclass with at least ``L``, ``hit``, ``ray`` and ``active``. Rays below the deepest level can only
    end in a source: where no tree ``branches``, they are traced after the loop, which saves all other lanes an
    iteration.
    """
    max_level = context.settings.max_level
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
    if ends and not context.lights.only_points:
        return state.L + last_emission(context, state.ray, camera, state.active), state.hit
    return state.L, state.hit


def differentiable_loop(state: Any, going: Callable[[Any], mi.Bool], step: Callable[[Any], Any]) -> Any:
    """The last of the states that ``step`` makes of ``state``, in each lane while it is ``going``, with derivatives.

    An iteration is one kernel, and its derivative another: the same for all iterations. Dr.Jit 1.5 cannot do that: of a
    symbolic loop that has derivatives it generates wrong code for masks; and its evaluated loop goes backwards in the
    order of a hash table, so that each iteration is compiled again.
    """
    dr.make_opaque(state)
    while dr.any(active := going(state)):
        state = dr.select(active, step(state), state)
        dr.eval(state)
        places = differentiable(state)
        if places:
            arrays = dr.custom(Boundary, [getattr(*place) for place in places])
            for place, array in zip(places, arrays):
                setattr(*place, array)
    return state


def differentiable(state: Any) -> list[tuple[Any, str]]:
    """The arrays in dataclasses and lists that have derivatives: each as the dataclass and the name of its field."""
    if isinstance(state, list):
        return [place for part in state for place in differentiable(part)]
    if not is_dataclass(state):
        return []
    values = {field.name: getattr(state, field.name) for field in fields(state)}
    found = [place for value in values.values() for place in differentiable(value)]
    arrays = {name: value for name, value in values.items() if isinstance(value, dr.ArrayBase)}
    return [(state, name) for name, value in arrays.items() if dr.grad_enabled(value)] + found


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
