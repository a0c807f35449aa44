"""A loop whose iterations have derivatives.

The loop is a loop of Python, because the two kinds of loops of Dr.Jit 1.5 do not suit. For a symbolic loop with
derivatives, Dr.Jit generates wrong code for masks. The backward pass of an evaluated loop visits variables in the order
of a hash table, so each iteration is compiled again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any

import drjit as dr


def differentiable_loop(state: Any, step: Callable[[Any], Any]) -> Any:
    """Applies ``step`` to ``state`` while the state is active, and returns the last state, with derivatives.

    A lane that is not active any more keeps its state. All iterations share one kernel, and the derivatives of all
    iterations share another kernel.
    """
    dr.make_opaque(state)
    while dr.any(active := state.active):
        state = dr.select(active, step(state), state)
        dr.eval(state)
        places = differentiable(state)
        if places:
            arrays = dr.custom(Boundary, [getattr(*place) for place in places])
            for place, array in zip(places, arrays):
                setattr(*place, array)
    return state


def differentiable(state: Any) -> list[tuple[Any, str]]:
    """Finds the arrays with derivatives in nested dataclasses and lists.

    Returns one pair for each array: the dataclass that holds the array, and the name of the array's field.
    """
    if isinstance(state, list):
        return [place for part in state for place in differentiable(part)]
    if not is_dataclass(state):
        return []
    values = {field.name: getattr(state, field.name) for field in fields(state)}
    found = [place for value in values.values() for place in differentiable(value)]
    arrays = {name: value for name, value in values.items() if isinstance(value, dr.ArrayBase)}
    return [(state, name) for name, value in arrays.items() if dr.grad_enabled(value)] + found


class Boundary(dr.CustomOp):
    """A Dr.Jit operation that returns its input arrays, and evaluates the derivatives of the arrays in a
    fixed order.
    """

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
