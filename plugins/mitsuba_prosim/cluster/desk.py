"""Errands on their way out and back."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from .errand import Errand


@dataclass(eq=False)
class Ticket:
    """An errand that is out. ``copies``: worker's address -> what cancels it there; ``failures``: what was said where
    it went wrong; ``lost``: how many workers were lost that were at it.
    """

    number: int
    errand: Errand
    copies: dict[str, Callable[[], Any]] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)
    lost: int = 0


class Desk:
    """Where errands are asked for, and their answers come back; ``in_order``: whether they are to be given in the order
    in which they were asked for.
    """

    def __init__(self, errands: Iterator[Errand], in_order: bool) -> None:
        self.errands, self.in_order = errands, in_order
        #: What has to be handed out once more.
        self.again: deque[Ticket] = deque()
        #: Whether all has been handed out once.
        self.exhausted = False
        self.number = self.given = 0
        self.early: dict[int, Any] = {}

    def next(self, ahead: int) -> Ticket | None:
        """The next ticket; None where there is none now. ``ahead``: how many may be out, or wait for those before them,
        where they are wanted in order.
        """
        if self.again:
            return self.again.popleft()
        if self.exhausted or (self.in_order and self.number - self.given >= ahead):
            return None
        errand = next(self.errands, None)
        if errand is None:
            self.exhausted = True
            return None
        self.number += 1
        return Ticket(self.number - 1, errand)

    @property
    def left(self) -> bool:
        """Whether there is something that is not out."""
        return bool(self.again) or not self.exhausted

    def give(self, ticket: Ticket, answer: Any) -> Iterator[Any]:
        """What can be given, now that this answer is there."""
        if not self.in_order:
            yield answer
            return
        self.early[ticket.number] = answer
        while self.given in self.early:
            yield self.early.pop(self.given)
            self.given += 1
