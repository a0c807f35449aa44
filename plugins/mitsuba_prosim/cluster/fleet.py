"""Who is given which portion, and how large it is: by the pace of each worker, as measured."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from .desk import Ticket

#: Portions that a worker has at a time: one that it works at, and one that it goes on with while the answer is on its
#: way.
DEPTH = 2

#: Seconds of a portion, at most and at least; where there are more workers than this, it is longer in proportion, as
#: one process hands out and gathers so many in a second.
LONGEST, SHORTEST, MANY = 4.0, 0.25, 100

#: A portion takes so many times what goes before it, at least.
TIMES = 4

#: Samples of the first portion, for each thread of a worker, as nobody knows its pace yet.
FIRST = 1 << 16

#: Towards the end portions are smaller: so many times are left for each worker.
ROUNDS = 2


@dataclass(eq=False)
class Worker:
    """A worker that takes part. ``pace``: samples in a second, 0 as long as nobody knows; ``before``: seconds that each
    portion takes beside; ``since``: when it began with the first of its ``queue``.
    """

    address: str
    threads: int
    pace: float = 0.0
    before: float = 0.0
    answers: int = 0
    since: float = 0.0
    queue: list[Ticket] = field(default_factory=list)

    def seconds(self, work: float) -> float:
        """What so many samples take."""
        return self.before + work / (self.pace or FIRST * self.threads)

    def learn(self, work: int, before: float, seconds: float) -> None:
        """Learns from a portion how fast it is; from the first, which had to compile, until the second is there."""
        new = work / max(seconds, 1e-6)
        half = 1.0 if self.answers < 2 else 0.5
        self.pace += half * (new - self.pace)
        self.before += half * (before - self.before)
        self.answers += 1


class Fleet:
    """The workers that take part, by address, and what each has to do. ``clock``: seconds."""

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self.workers: dict[str, Worker] = {}
        self.clock = clock

    def free(self) -> Worker | None:
        """The worker that should get the next portion: one that has the fewest, the fastest of them."""
        free = [worker for worker in self.workers.values() if len(worker.queue) < DEPTH]
        return min(free, key=lambda worker: (len(worker.queue), -worker.pace), default=None)

    def bound(self, worker: Worker, most: int | None, left: int) -> int:
        """Samples of the next portion of ``worker``; ``most``: of the portions of all together, if there is a reason to
        bound them; ``left``: samples that are still to be asked for.
        """
        if not worker.pace:
            return FIRST * worker.threads
        pace = sum(other.pace or worker.pace for other in self.workers.values())
        seconds = min(LONGEST * max(1, len(self.workers) / MANY), left / pace / ROUNDS)
        if most is not None:
            seconds = min(seconds, most / pace)
        return max(1, int(worker.pace * max(seconds, SHORTEST, TIMES * worker.before)))

    def give(self, ticket: Ticket, worker: Worker, cancel: Callable[[], Any]) -> None:
        """Notes that ``worker`` has it."""
        if not worker.queue:
            worker.since = self.clock()
        worker.queue.append(ticket)
        ticket.copies[worker.address] = cancel

    def take_back(self, ticket: Ticket, address: str | None = None) -> None:
        """Notes that the worker of that address has it no more; without one, that none has."""
        for place in [address] if address else list(ticket.copies):
            ticket.copies.pop(place)()
            if (worker := self.workers.get(place)) is not None:
                if worker.queue[0] is ticket:
                    worker.since = self.clock()  # it begins with the next
                worker.queue.remove(ticket)

    def remove(self, address: str) -> list[Ticket]:
        """A worker that is there no more. Returns what nobody else has."""
        worker = self.workers.pop(address)
        if worker.queue:
            worker.queue[0].lost += 1
        for ticket in worker.queue:
            ticket.copies.pop(address)()
        return [ticket for ticket in worker.queue if not ticket.copies]

    def out(self) -> list[Ticket]:
        """All that is out."""
        return list(dict.fromkeys(ticket for worker in self.workers.values() for ticket in worker.queue))

    def repeats(self) -> Iterator[tuple[Ticket, Worker]]:
        """What is worth while to be done once more, by a worker that has nothing to do: where it will be done sooner
        so, as far as can be known.
        """
        now = self.clock()
        for idle in [worker for worker in self.workers.values() if not worker.queue]:
            late, ticket = max(self._ends(now), key=lambda one: one[0], default=(0.0, None))
            if ticket is not None and late > 1.25 * idle.seconds(ticket.errand.work) + SHORTEST:
                yield ticket, idle

    def _ends(self, now: float) -> Iterator[tuple[float, Ticket]]:
        """``(seconds, ticket)`` of all that one worker alone has: until it is expected; or, where it should have been
        there, since then, as it may take as long again.
        """
        for worker in self.workers.values():
            end = worker.since
            for ticket in worker.queue:
                end += worker.seconds(ticket.errand.work)
                if len(ticket.copies) == 1:
                    yield abs(end - now), ticket
