"""Samples that the workers of a Dask cluster take."""

from __future__ import annotations

import asyncio
import queue
from collections.abc import Callable, Generator, Iterable, Iterator
from typing import Any

import distributed
import mitsuba as mi

from ..engine.work import Results, WorkItem
from ..photons.caustics import Which
from . import worker
from .desk import Desk, Ticket
from .errand import Errand, Whole
from .faults import LOSSES, ClusterError, lost
from .fleet import DEPTH, Fleet, Worker
from .joining import Joining
from .link import Link
from .parcel import Parcel
from .sets import PhotonSets

#: Seconds from one look at who is there to the next.
LOOK = 0.5

#: A portion may go wrong so often, less one.
ATTEMPTS = 3

#: Where portions are wanted in their order, so many for each worker may be out or wait for those before.
AHEAD = 2 * DEPTH


class Remote:
    """Takes samples by the workers of ``client``; an :class:`~mitsuba_prosim.engine.work.Executor`.

    Workers come and go, and take part as soon as they have the scene, the ``parcel``; what one takes with it is done by
    others. ``say``: told of workers that can't take part. To be closed in the end.
    """

    sets = None

    def __init__(self, client: distributed.Client, parcel: Parcel, say: Callable[[str], None] = lambda _: None) -> None:
        self.link, self.say = Link(client), say
        self.variant = mi.variant() or ""
        self.fleet = Fleet()
        self.joining = Joining(self.link, parcel, say, lambda *told: self.events.put((self._joined, *told)))
        self.photons = PhotonSets(self._draw)
        #: Why the cluster is there no more.
        self.gone: str | None = None
        self.missed = False  # whether it was said that one was lost
        self.events: queue.SimpleQueue[tuple[Any, ...]] = queue.SimpleQueue()
        self.asking: Worker | None = None
        #: Errands that were answered; seconds that the workers took for them, all together, and without what goes
        #: before each; and their samples.
        self.portions, self.busy, self.taking, self.work = 0, 0.0, 0.0, 0
        self.address = getattr(client.scheduler, "address", "of the cluster")
        self.watch = self.link.begin(self._watch())

    def turn_to(self, parcel: Parcel) -> None:
        """Goes on with another scene, between two images. Of its files the workers are sent what they have not got."""
        self.joining.turn_to(parcel)
        self.link.keep(parcel.contents.values())
        self.photons.forget()
        for address in list(self.fleet.workers):
            self.fleet.remove(address)
            self.joining.ask(address)

    def close(self) -> None:
        """Lets the workers go; they keep the scene for the next time."""
        self.watch.cancel()
        for ticket in self.fleet.out():
            self.fleet.take_back(ticket)
        self.joining.close()
        self.link.keep([])
        self.photons.forget()

    def __enter__(self) -> Remote:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # ---------------------------------------------------------------- as a taker

    def limit(self, most: int | None, left: int) -> int | None:
        """Samples of a portion that the worker which is to get it does in seconds."""
        return most if self.asking is None else self.fleet.bound(self.asking, most, left)

    def __call__(self, items: Iterator[WorkItem], ordered: bool) -> Results:
        """Hands the work items out, and gives them back as they are answered.

        Raises ClusterError where no worker can take part, or where a portion goes wrong again and again.
        """
        errands = (Errand.portion(item, self.joining.parcel.key) for item in items)
        return self._done(Desk(errands, ordered))

    def make(self, images: Iterable[Whole]) -> Generator[tuple[Whole, Any] | None, None, None]:
        """Lets each worker make images by itself, and gives what they came to, as it is there, and None from time to
        time; some of ``images`` are asked for in advance.

        Raises ClusterError as for portions.
        """
        errands = (Errand.whole(image, self.joining.parcel.key, self.link.has) for image in images)
        return self._done(Desk(errands, False))

    def _done(self, desk: Desk) -> Generator[Any, None, None]:
        try:
            while self.gone is None:
                self._hand_out(desk)
                if not desk.left and not self.fleet.out():
                    return
                for ticket, what in self._heard(desk):
                    yield from desk.give(ticket, ticket.errand.read(what))
                yield None
        finally:
            for ticket in self.fleet.out():
                self.fleet.take_back(ticket)

    def _hand_out(self, desk: Desk) -> None:
        """Gives every worker what it has time for."""
        while (free := self.fleet.free()) is not None:
            self.asking = free
            ticket = desk.next(AHEAD * len(self.fleet.workers))
            if ticket is None:
                break
            self._send(ticket, free)
        if not desk.left:
            for ticket, idle in self.fleet.repeats():
                self._send(ticket, idle)

    def _send(self, ticket: Ticket, to: Worker) -> None:
        errand = ticket.errand
        needed = [self.link.file(content) for content in errand.files] + self.photons.of(errand, self.fleet.workers)
        future = self.link.submit(to.address, errand.function, self.variant, *errand.arguments, *needed)

        async def collect() -> None:
            self.events.put((self._answered, ticket, to.address, await self.link.outcome(future)))

        # What is released ends the gathering as well.
        self.fleet.give(ticket, to, future.release)
        self.link.begin(collect())

    def _draw(self, errand: Errand, which: Which, address: str) -> distributed.Future:
        return self.link.submit(address, worker.draw, self.variant, self.joining.parcel.key, errand.plan, which)

    def _heard(self, desk: Desk) -> Iterator[tuple[Ticket, Any]]:
        """What is heard from the cluster in the next moment: the answers to tickets, each once."""
        try:
            events = [self.events.get(timeout=LOOK / 5)]
            while not self.events.empty():
                events.append(self.events.get())
        except queue.Empty:
            events = []
        for act, *what in events:
            if (answer := act(desk, *what)) is not None:
                yield answer
        if not self.fleet.workers:
            self.joining.check()

    def _answered(self, desk: Desk, ticket: Ticket, address: str, outcome: Any) -> tuple[Ticket, Any] | None:
        if address not in ticket.copies:
            return None  # another was first, or the worker has gone
        if isinstance(outcome, worker.Done):
            self.fleet.workers[address].learn(ticket.errand.work, outcome.before, outcome.seconds)
            self.portions += 1
            self.busy += outcome.drawing + outcome.before + outcome.seconds
            self.taking, self.work = self.taking + outcome.seconds, self.work + ticket.errand.work
            self.fleet.take_back(ticket)
            return ticket, outcome.what
        self.fleet.take_back(ticket, address)
        self.photons.forget(ticket.errand.sets)
        if outcome is None:  # other scenes have taken the place of this one
            desk.again.extend(self.fleet.remove(address))
            self.joining.ask(address)
        elif not lost(outcome):
            ticket.failures.append(f"{address}: {outcome}")
            if len(ticket.failures) >= ATTEMPTS:
                raise ClusterError(f"{ticket.errand.wrong}, by the worker {ticket.failures[-1]}") from outcome
        if not ticket.copies:
            desk.again.append(ticket)
        return None

    # ---------------------------------------------------------------- who is there

    def _present(self, desk: Desk, addresses: frozenset[str]) -> None:
        """Looks at who has come, and who has gone."""
        absent = (set(self.fleet.workers) | set(self.joining.asked)) - addresses
        for address in set(self.fleet.workers) - addresses:
            desk.again.extend(self.fleet.remove(address))
            lost_sets = self.photons.lose(address)
            for ticket in self.fleet.out():
                if lost_sets & set(ticket.errand.sets):  # it would wait for what is drawn no more
                    self.fleet.take_back(ticket)
                    desk.again.append(ticket)
            if any(ticket.lost >= LOSSES for ticket in desk.again):
                raise ClusterError(
                    f"{LOSSES} workers were lost that were at the same samples; have they enough memory?"
                )
        if absent and not self.missed:
            self.missed = True
            left = len(addresses - set(self.joining.refused))
            self.say(
                f"a worker was lost, {left or 'none'} {'is' if left < 2 else 'are'} left; others do what it had at "
                "hand, and the image stays the same"
            )
        self.joining.look(addresses, self.fleet.workers)

    def _joined(self, desk: Desk, address: str, told: worker.Greeting | Exception) -> None:
        greeting = self.joining.answered(address, told)
        if greeting is not None:
            self.fleet.workers[address] = Worker(address, greeting.threads)

    def _lost(self, desk: Desk, why: str) -> None:
        self.gone = why

    async def _watch(self) -> None:
        """Tells who is there, and when nobody knows any more."""
        while True:
            if (present := await self.link.present()) is None:
                self.events.put((self._lost, f"the scheduler {self.address} has gone away"))
                return
            self.events.put((self._present, present))
            await asyncio.sleep(LOOK)
