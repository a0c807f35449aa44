"""Samples that the workers of a Dask cluster take."""

from __future__ import annotations

import asyncio
import itertools
import queue
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any

import distributed
import mitsuba as mi
from distributed.comm.core import CommClosedError

from ..caustics.caustics import Which
from ..rendering.estimate import Estimate
from ..rendering.taking import Portion
from ..saved import origin
from . import worker
from .desk import Desk, Ticket
from .errand import Errand, Whole
from .fleet import DEPTH, Fleet, Worker
from .link import Link
from .parcel import Parcel
from .sets import PhotonSets

#: Seconds from one look at who is there to the next; after which without any worker it is said that there is none; and
#: that a worker has to answer directly, else the scheduler passes on what it says.
LOOK, PATIENCE, DIRECT = 0.5, 10.0, 3.0

#: A portion may go wrong so often, less one; and so many workers may be lost that are at it, or at loading the scene.
ATTEMPTS, LOSSES = 3, 10

#: Where portions are wanted in their order, so many for each worker may be out or wait for those before.
AHEAD = 2 * DEPTH


class ClusterError(RuntimeError):
    """A cluster that can't render the image."""


class Remote:
    """Takes samples by the workers of ``client``; a :class:`~mitsuba_prosim.rendering.taking.Taker`.

    Workers come and go, and take part as soon as they have the scene, the ``parcel``; what one takes with it is done by
    others. ``say``: told of workers that can't take part. To be closed in the end.
    """

    in_turn = False

    def __init__(self, client: distributed.Client, parcel: Parcel, say: Callable[[str], None] = lambda _: None) -> None:
        self.link, self.parcel, self.say = Link(client), parcel, say
        self.before: str | None = None  # key of the scene before this one
        self.variant, self.ours = mi.variant() or "", origin.here()
        self.fleet = Fleet()
        self.photons = PhotonSets(self._draw)
        #: Why the cluster is there no more; and what is called then.
        self.gone: str | None = None
        self.stop: Callable[[], None] = lambda: None
        self.refused: dict[str, str] = {}
        self.missed = False  # whether it was said that one was lost
        self.fallen = 0  # workers that were lost before they were ready
        self.joining: dict[str, list[distributed.Future]] = {}  # what is asked of those that come
        self.events: queue.SimpleQueue[tuple[Any, ...]] = queue.SimpleQueue()
        self.asking: Worker | None = None
        #: Errands that were answered; seconds that the workers took for them, all together, and without what goes
        #: before each; and their samples.
        self.portions, self.busy, self.taking, self.work = 0, 0.0, 0.0, 0
        self.since = time.perf_counter()
        self.warned: set[str] = set()
        self.address = getattr(client.scheduler, "address", "of the cluster")
        self.watch = self.link.begin(self._watch())

    def turn_to(self, parcel: Parcel) -> None:
        """Goes on with another scene, between two images. Of its files the workers are sent what they have not got."""
        self.before = self.parcel.key if self.parcel.key != parcel.key else self.before
        self.parcel, self.fallen, self.since = parcel, 0, time.perf_counter()
        self.refused.clear()  # who could not take part is asked again
        self.link.keep(parcel.contents.values())
        self.photons.forget()
        for address in list(self.fleet.workers):
            self.fleet.remove(address)
            self._join(address)

    def close(self) -> None:
        """Lets the workers go; they keep the scene for the next time."""
        self.watch.cancel()
        for ticket in self.fleet.out():
            self.fleet.take_back(ticket)
        for future in itertools.chain(*self.joining.values()):
            future.release()
        self.link.keep([])
        self.photons.forget()

    def __enter__(self) -> Remote:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # ---------------------------------------------------------------- as a taker

    def bound(self, most: int | None, left: int) -> int | None:
        """Samples of a portion that the worker which is to get it does in seconds."""
        return most if self.asking is None else self.fleet.bound(self.asking, most, left)

    def __call__(
        self, portions: Iterator[Portion], cancelled: Callable[[], bool], in_order: bool
    ) -> Iterator[tuple[Portion, Estimate]]:
        """Hands the portions out, and gives them back as they are answered.

        Raises ClusterError where no worker can take part, or where a portion goes wrong again and again.
        """
        errands = (Errand.portion(portion, self.parcel.key) for portion in portions)
        return self._done(Desk(errands, in_order), cancelled)

    def make(self, images: Iterable[Whole], cancelled: Callable[[], bool]) -> Iterator[tuple[Whole, Any]]:
        """Lets each worker make images by itself, and gives what they came to, as it is there; some of ``images`` are
        asked for in advance.

        Raises ClusterError as for portions.
        """
        errands = (Errand.whole(image, self.parcel.key, self.link.has) for image in images)
        return self._done(Desk(errands, False), cancelled)

    def _done(self, desk: Desk, cancelled: Callable[[], bool]) -> Iterator[Any]:
        try:
            while not cancelled() and self.gone is None:
                self._hand_out(desk)
                if not desk.left and not self.fleet.out():
                    return
                for ticket, what in self._heard(desk):
                    yield from desk.give(ticket, ticket.errand.read(what))
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
        return self.link.submit(address, worker.draw, self.variant, self.parcel.key, errand.plan, which)

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
        if not self.fleet.workers and not self.joining:
            if self.refused:
                raise ClusterError("no worker of the cluster can take part: " + "; ".join(self.refused.values()))
            if time.perf_counter() - self.since > PATIENCE:
                self._warn_once("the cluster has no workers yet; the render begins when there are some")

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
            self._join(address)
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
        absent = (set(self.fleet.workers) | set(self.joining)) - addresses
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
            left = len(addresses - set(self.refused))
            self.say(
                f"a worker was lost, {left or 'none'} {'is' if left < 2 else 'are'} left; others do what it had at "
                "hand, and the image stays the same"
            )
        for address in set(self.joining) - addresses:
            for future in self.joining.pop(address):
                future.release()
            self.fallen += 1
            if self.fallen >= LOSSES and not self.fleet.workers:
                raise ClusterError(
                    f"{LOSSES} workers were lost when they were given the scene; have they enough memory, and does "
                    "prosim doctor find nothing wrong there?"
                )
        for address in set(self.refused) - addresses:
            del self.refused[address]
        for address in addresses - set(self.fleet.workers) - set(self.joining) - set(self.refused):
            self._join(address)

    def _join(self, address: str) -> None:
        async def greet() -> None:
            try:
                self.events.put((self._joined, address, await self._greeted(address)))
            except Exception as error:  # noqa: BLE001 (whatever it is, the others go on)
                self.events.put((self._joined, address, error))

        self.joining[address] = []
        self.link.begin(greet())

    async def _greeted(self, address: str) -> worker.Greeting:
        """The greeting of a worker that is of our kind, and has the scene."""
        future = self.link.submit(address, worker.greet, self.variant, self.parcel.key)
        self.joining[address].append(future)
        greeting = await self.link.outcome(future, direct=False, release=False)
        if isinstance(greeting, BaseException):
            raise greeting
        if self.link.direct is None:
            try:
                await asyncio.wait_for(self.link.outcome(future, direct=True), DIRECT)
                self.link.direct = True
            except asyncio.TimeoutError:
                self.link.direct = False
        if different := origin.differences(greeting.origin, self.ours, origin.EXACT):
            raise ClusterError(f"it would not make the same samples ({different})")
        if not greeting.loaded:
            futures = [self.link.file(content) for content in self.parcel.contents.values()]
            bare, names = replace(self.parcel, contents={}), list(self.parcel.contents)
            loading = self.link.submit(address, worker.load, self.variant, bare, self.before, names, *futures)
            if address in self.joining:
                self.joining[address].append(loading)
            if isinstance(error := await self.link.outcome(loading), BaseException):
                raise error
        return greeting

    def _joined(self, desk: Desk, address: str, greeting: worker.Greeting | Exception) -> None:
        if self.joining.pop(address, None) is None:
            return  # it has gone
        if isinstance(greeting, Exception):
            if lost(greeting):  # it is asked again, if it is there
                self.fallen += 1
            else:
                self.refused[address] = f"{address}: {said(greeting)}"
                self._warn_once(f"a worker can't take part, {self.refused[address]}")
            return
        self.fleet.workers[address] = Worker(address, greeting.threads)
        if different := origin.differences(greeting.origin, self.ours, origin.CLOSE):
            self._warn_once(
                f"the worker {address} is of another kind ({different}): its samples are as good, but may differ in "
                "their last bits"
            )

    def _warn_once(self, text: str) -> None:
        if text not in self.warned:
            self.warned.add(text)
            self.say(text)

    def _lost(self, desk: Desk, why: str) -> None:
        self.gone = why
        self.stop()

    async def _watch(self) -> None:
        """Tells who is there, and when nobody knows any more."""
        while True:
            if (present := await self.link.present()) is None:
                self.events.put((self._lost, f"the scheduler {self.address} has gone away"))
                return
            self.events.put((self._present, present))
            await asyncio.sleep(LOOK)


def lost(error: BaseException) -> bool:
    """Whether it was not the work that went wrong, but the worker that went."""
    return isinstance(error, (distributed.KilledWorker, distributed.CancelledError, CommClosedError))


def said(error: BaseException) -> str:
    """Why a worker can't take part."""
    if isinstance(error, (ImportError, AttributeError)):
        return f"it has no mitsuba-prosim of this version, or not all that it needs ({error})"
    return str(error) or type(error).__name__
