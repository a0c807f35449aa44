"""Chains of + and -: A + B - C + D and so on, taken from left to right.

An operand joins the earliest *round* that comes after all earlier operands that it touches and does not commute with; a
round takes away first, and then adds. So the number of rounds is that of the additions and subtractions that alternate
at one place. Where there are many, those that later ones cover are left out first, see :mod:`.hidden`.

Many rounds are evaluated in halves. A sequence of rounds takes X to X - S + P, with solids S and P of its own, and two
of these in succession are one of their kind:

    (X - S + P) - S' + P' = X - (S + S') + ((P - S') + P').

So no operation meets the whole result again and again. What it leaves open is whose a face is that several operands
have in common. That is settled by :func:`_associative`, which else leaves the rounds to be taken one by one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import takewhile

import numpy as np

from .hidden import Extent, covered, within_boxes
from .parts import Part, boxes, union
from .sweep import touching
from .values import Value, total, united, without

DEEP = 64  # rounds


@dataclass(eq=False)
class _Operand:
    """An operand of a chain: whether it is added, its value, the parts of this and the box around them."""

    added: bool
    value: Value
    parts: list[Part]
    low: np.ndarray
    high: np.ndarray

    def extent(self) -> Extent:
        """Where it lies."""
        known = self.parts[0].extent if len(self.parts) == 1 else None
        return known() if known else within_boxes(self.low, self.high)


def evaluate(operands: Sequence[tuple[str, Value]]) -> Value:
    """The value of a chain: signs, "+" or "-", and operands; the first one is positive."""
    chain = [_operand(sign == "+", value) for sign, value in operands]
    order = list(takewhile(lambda number: number < DEEP, _rounds(chain)))
    if len(order) < len(chain):
        chain = _not_covered(chain)
        order = list(_rounds(chain))
    count = max(order) + 1
    taken: list[list[list[Part]]] = [[] for _ in range(count)]
    added: list[list[Value]] = [[] for _ in range(count)]
    for one, number in zip(chain, order):
        if one.added:
            added[number].append(one.value)
        else:
            taken[number].append(total(one.value))
    if count > DEEP and _associative(chain):
        return in_halves(taken, added, 0, count)[1]
    result: Value = {}
    for some, others in zip(taken, added):
        result = united([without(result, union(some)), *others])
    return result


def in_halves(
    taken: list[list[list[Part]]], added: list[list[Value]], begin: int, end: int
) -> tuple[list[Part], Value]:
    """S and P of the rounds from ``begin`` to ``end``; of the very first ones S is of no use, and left out."""
    if end - begin == 1:
        return union(taken[begin]) if begin else [], united(added[begin])
    middle = (begin + end) // 2
    first, result = in_halves(taken, added, begin, middle)
    second, more = in_halves(taken, added, middle, end)
    return union([first, second]) if begin else [], united([without(result, second), more])


def _operand(added: bool, value: Value) -> _Operand:
    parts = [part for some in value.values() for part in some]
    low, high = boxes(parts)
    return _Operand(added, value, parts, low.min(axis=0, initial=np.inf), high.max(axis=0, initial=-np.inf))


def _rounds(chain: list[_Operand]) -> Iterator[int]:
    """The number of each operand's round, in turn."""
    adds = np.array([one.added for one in chain])
    low, high = (np.asfortranarray(ends) for ends in ([one.low for one in chain], [one.high for one in chain]))
    order = np.zeros(len(chain), int)
    for i in range(len(chain)):
        near = touching(low[:i], high[:i], (low[i], high[i]))
        order[i] = (order[near] + (adds[near] & ~adds[i])).max(initial=0)
        yield int(order[i])


def _not_covered(chain: list[_Operand]) -> list[_Operand]:
    """A chain without the operands that later ones cover. Of several media it stays as it is: none covers another's."""
    chain = [one for one in chain if one.parts]
    if len({medium for one in chain for medium in one.value}) > 1:
        return chain
    margin = 16 * chain[0].parts[0].planes.step  # far from where coincident faces are moved to
    gone = covered([one.extent() for one in chain], margin)
    return [one for one, hidden in zip(chain, gone.tolist()) if not hidden]


def _associative(chain: list[_Operand]) -> bool:
    """Whether a chain may be evaluated in halves, and every face goes to the operand that it goes to one by one.

    Where a face of the result is covered by a later operand, and laid bare again by one still later that has a face on
    the same surface, it is the latter's; but in halves the first one's. It cannot be covered if nothing that is added
    reaches beyond the surface.
    """
    adds = np.array([one.added for one in chain])
    low, high = np.array([one.low for one in chain]), np.array([one.high for one in chain])
    surfaces = [frozenset().union(*(part.surfaces for part in one.parts)) for one in chain]
    for i in np.flatnonzero(~adds).tolist():
        if not surfaces[i]:
            continue
        near = touching(low, high, (low[i], high[i]))
        before = [surfaces[j] & surfaces[i] for j in near[near < i].tolist()]
        added = near[adds[near]]
        for surface in frozenset().union(*before):
            if not chain[i].parts[0].planes.one_sided(surface, low[added], high[added]):
                return False
    return True
