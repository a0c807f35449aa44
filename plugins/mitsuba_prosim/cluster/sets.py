"""Sets of photons that workers draw for each other, each set once."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..photons.caustics import Which

if TYPE_CHECKING:
    import distributed

    from .errand import Errand

#: Sets that are kept for workers that have not got them yet: as many as a worker keeps of sets of the usual size. An
#: errand that needs more draws them itself, one after the other.
KEPT = 4


@dataclass(frozen=True)
class Drawn:
    """A set of photons, and the address of the worker that draws it."""

    future: distributed.Future
    address: str


class PhotonSets:
    """Who draws which set. ``draw(errand, which, address)``: has the worker of that address draw one."""

    def __init__(self, draw: Callable[[Errand, Which, str], distributed.Future]) -> None:
        self.draw = draw
        self.drawn: OrderedDict[Which, Drawn] = OrderedDict()

    def of(self, errand: Errand, addresses: Iterable[str]) -> list[distributed.Future]:
        """The sets that an errand needs; the workers of these addresses draw those that nobody has drawn."""
        if len(errand.sets) > KEPT:
            return []
        for which in errand.sets:
            if which not in self.drawn:
                busy = Counter(drawn.address for drawn in self.drawn.values())
                address = min(addresses, key=busy.__getitem__)
                self.drawn[which] = Drawn(self.draw(errand, which, address), address)
            self.drawn.move_to_end(which)
        while len(self.drawn) > KEPT:
            self.drawn.popitem(last=False)[1].future.release()
        return [self.drawn[which].future for which in errand.sets]

    def lose(self, address: str) -> set[Which]:
        """A worker that is there no more; which sets it was to draw."""
        gone = {which for which, drawn in self.drawn.items() if drawn.address == address}
        self.forget(gone)
        return gone

    def forget(self, sets: Iterable[Which] | None = None) -> None:
        """Lets these go, or all."""
        for which in list(self.drawn) if sets is None else sets:
            if (drawn := self.drawn.pop(which, None)) is not None:
                drawn.future.release()
