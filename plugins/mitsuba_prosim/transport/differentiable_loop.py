"""A loop through which Dr.Jit computes derivatives.

The loop is a ``while`` loop of Python, because derivatives are a problem for both kinds of loops of Dr.Jit 1.5,
symbolic and evaluated. Dr.Jit 1.5 generates wrong code for the masks of a symbolic loop with derivatives. The backward
pass of an evaluated loop of Dr.Jit visits variables in the order of a hash table, so Dr.Jit compiles a new kernel for
each iteration.
"""

from collections.abc import Callable
from dataclasses import is_dataclass
from typing import Any

import drjit as dr


def differentiable_loop(state: Any, step: Callable[[Any], Any]) -> Any:
    """Applies ``step`` to ``state`` until no lane of ``state.active`` is true, and returns the last state, with
    derivatives.

    ``state`` is a dataclass of arrays, nested dataclasses and lists; a finished lane keeps its state. All iterations
    run the same compiled kernel, and a second kernel computes all their derivatives.
    """
    dr.make_opaque(state)
    while dr.any(active := state.active):
        state = dr.select(active, step(state), state)
        dr.eval(state)
        places = differentiable(state)
        # A Boundary evaluates the derivatives between two iterations, so all iterations have the same second kernel.
        arrays = dr.custom(Boundary, [getattr(*place) for place in places])
        for place, array in zip(places, arrays):
            setattr(*place, array)
    return state


def differentiable(state: Any) -> list[tuple[Any, str]]:
    """Returns the dataclass and the name of the field for each array with derivatives in ``state``, except for arrays
    that are directly in a list.
    """
    if isinstance(state, list):
        return [place for part in state for place in differentiable(part)]
    if not is_dataclass(state):
        return []
    found = [place for value in vars(state).values() for place in differentiable(value)]
    arrays = {name: value for name, value in vars(state).items() if isinstance(value, dr.ArrayBase)}
    return [(state, name) for name, value in arrays.items() if dr.grad_enabled(value)] + found


class Boundary(dr.CustomOp):
    """A Dr.Jit operation that returns its inputs, and evaluates their derivatives in a fixed order."""

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
