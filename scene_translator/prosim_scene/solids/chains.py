"""Chains of + and -: A + B - C + D and so on, taken from left to right.

An operand joins the earliest *round* that comes after all earlier operands that it touches and does not commute with; a
round takes away first, and then adds. So the number of rounds is that of the additions and subtractions that alternate
at one place.

Many rounds are evaluated in halves. A sequence of rounds takes X to X - S + P, with solids S and P of its own, and two
of these in succession are one of their kind:

    (X - S + P) - S' + P' = X - (S + S') + ((P - S') + P').

So no operation meets the whole result again and again. What it leaves open is whose a face is that several operands
have in common. That is settled by :func:`_associative`, which else leaves the rounds to be taken one by one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .parts import Part, boxes, union
from .sweep import touching
from .values import Value, total, united, without

DEEP = 64  # rounds


def evaluate(operands: Sequence[tuple[str, Value]]) -> Value:
    """The value of a chain: signs, "+" or "-", and operands; the first one is positive."""
    adds = np.array([sign == "+" for sign, _ in operands])
    values = [value for _, value in operands]
    parts = [[p for some in value.values() for p in some] for value in values]
    ends = [boxes(some) for some in parts]
    low = np.array([b.min(axis=0, initial=np.inf) for b, _ in ends])
    high = np.array([b.max(axis=0, initial=-np.inf) for _, b in ends])
    order = np.zeros(len(adds), int)
    for i in range(1, len(adds)):
        near = touching(low[:i], high[:i], (low[i], high[i]))
        order[i] = (order[near] + (adds[near] & ~adds[i])).max(initial=0)
    count = int(order.max()) + 1
    taken: list[list[list[Part]]] = [[] for _ in range(count)]
    added: list[list[Value]] = [[] for _ in range(count)]
    for adding, value, number in zip(adds.tolist(), values, order.tolist()):
        if adding:
            added[number].append(value)
        else:
            taken[number].append(total(value))
    if count > DEEP and _associative(adds, low, high, parts):
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


def _associative(adds: np.ndarray, low: np.ndarray, high: np.ndarray, parts: list[list[Part]]) -> bool:
    """Whether a chain may be evaluated in halves, and every face goes to the operand that it goes to one by one.

    Where a face of the result is covered by a later operand, and laid bare again by one still later that has a face on
    the same surface, it is the latter's; but in halves the first one's. It cannot be covered if nothing that is added
    reaches beyond the surface.
    """
    surfaces = [frozenset().union(*(p.surfaces for p in some)) for some in parts]
    for i in np.flatnonzero(~adds).tolist():
        if not surfaces[i]:
            continue
        near = touching(low, high, (low[i], high[i]))
        before = [surfaces[j] & surfaces[i] for j in near[near < i].tolist()]
        added = near[adds[near]]
        for surface in frozenset().union(*before):
            if not parts[i][0].planes.one_sided(surface, low[added], high[added]):
                return False
    return True
