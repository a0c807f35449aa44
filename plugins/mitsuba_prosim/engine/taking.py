"""Samples that are asked for, portion by portion, and who takes them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import drjit as dr
import mitsuba as mi

from ..alone import alone
from . import collector
from .estimate import Estimate, Estimator
from .plan import Plan

if TYPE_CHECKING:
    from .estimate import Quiet


@dataclass(frozen=True)
class Portion:
    """The pixels (x, y), which go on from ``start``, in stages, each until they have the counts of its end, or are
    ``quiet``. All arrays are evaluated, with one entry a pixel.
    """

    estimator: Estimator
    x: mi.Int32
    y: mi.Int32
    start: Estimate
    stages: Sequence[tuple[Plan, mi.UInt32]]
    quiet: Quiet | None
    #: Samples that it takes, about; and what part of all is done before it and with it, if they are taken in order.
    work: int
    span: tuple[float, float]
    #: What the samples are given to.
    put: Callable[[Estimate], None]

    def sets(self) -> list[tuple[int, int, int]]:
        """The sets of photons that it needs, see :meth:`.Estimator.sets`."""
        found: list[tuple[int, int, int]] = []
        count = self.start.count
        for plan, end in self.stages:
            found += self.estimator.sets(plan, count, end)
            count = dr.maximum(count, end)
        return found

    def take(self, running: Callable[[], AbstractContextManager[Any]] = nullcontext) -> Estimate:
        """Takes the samples, in this process. ``running()`` surrounds the running of kernels; what goes before, as
        Dr.Jit follows the code, takes as long for few samples as for many.
        """
        more = self.start
        with collector.suspended(), alone():
            for plan, end in self.stages:
                self.estimator.plan = plan
                more = self.estimator.take(self.x, self.y, more, end, self.quiet, running)
        return more


class Taker(Protocol):
    """Who takes the samples of portions; whoever it is, they are the same. ``in_turn``: whether each portion has been
    put where it belongs before the next one is asked for.
    """

    in_turn: bool

    def bound(self, most: int | None, left: int) -> int | None:
        """Samples of the next portion, at most; None: no bound. ``most``: where there is another reason to bound them;
        ``left``: samples that are still to be asked for.
        """

    def __call__(
        self, portions: Iterator[Portion], cancelled: Callable[[], bool], in_order: bool
    ) -> Iterator[tuple[Portion, Estimate]]:
        """Takes portion after portion, until there is none or it is ``cancelled``, which is asked from time to time;
        ``in_order``: whether they are to be given in the order in which they are asked for.
        """


class Here:
    """Takes them in this process, one portion after the other."""

    in_turn = True

    def bound(self, most: int | None, left: int) -> int | None:
        """As many as may be."""
        return most

    def __call__(
        self, portions: Iterator[Portion], cancelled: Callable[[], bool], in_order: bool
    ) -> Iterator[tuple[Portion, Estimate]]:
        """Takes them."""
        for portion in portions:
            if cancelled():
                return
            yield portion, portion.take()


class Round:
    """The portions of some ``steps``, each taken and put where it belongs: an iterator of the part that is done, 0 to
    1. Those of a step are asked for when all before them are where they belong.
    """

    def __init__(
        self, steps: Iterable[Iterator[Portion]], taker: Taker, cancelled: Callable[[], bool], in_order: bool = False
    ) -> None:
        self.steps, self.taker, self.cancelled, self.in_order = steps, taker, cancelled, in_order
        self.asked, self.taken = 0, 0
        #: The part that is done when all that was asked for is taken; and what of it is not taken yet.
        self.end, self.open = 0.0, 0.0
        #: Whether all portions of a step have been asked for, and whether all has been taken.
        self.exhausted = self.whole = False

    def __iter__(self) -> Iterator[float]:
        for portions in self.steps:
            self.exhausted = False
            for portion, more in self.taker(self._asking(portions), self.cancelled, self.in_order):
                portion.put(more)
                self.taken += 1
                self.open = self.open - width(portion) if self.taken < self.asked else 0.0
                yield self.end - self.open
            if not self.exhausted or self.taken < self.asked:
                return
        self.whole = True

    def _asking(self, portions: Iterator[Portion]) -> Iterator[Portion]:
        for portion in portions:
            self.asked += 1
            self.end, self.open = portion.span[1], self.open + width(portion)
            yield portion
        self.exhausted = True


def width(portion: Portion) -> float:
    """What part of all ``portion`` is."""
    return portion.span[1] - portion.span[0]
