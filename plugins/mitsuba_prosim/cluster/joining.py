"""How workers come to take part: each is greeted, and given the scene."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Collection
from dataclasses import replace

import distributed
import mitsuba as mi

from ..saved import origin
from . import worker
from .faults import LOSSES, ClusterError, lost, said
from .link import Link
from .parcel import Parcel

#: Seconds after which it is said that there is no worker; and that one has to answer directly, else the scheduler
#: passes on what it says.
PATIENCE, DIRECT = 10.0, 3.0


class Joining:
    """The workers that are on their way to the scene in ``parcel``, and those that can't take part, of which ``say`` is
    told. ``tell(address, greeting)``: called, in the client's loop, with the greeting of one that is ready, or with the
    error.
    """

    def __init__(
        self,
        link: Link,
        parcel: Parcel,
        say: Callable[[str], None],
        tell: Callable[[str, worker.Greeting | Exception], None],
    ) -> None:
        self.link, self.parcel, self.say, self.tell = link, parcel, say, tell
        self.before: str | None = None  # key of the scene before this one
        self.variant, self.ours = mi.variant() or "", origin.here()
        #: What is asked of those that come, by their addresses; and why others can't take part.
        self.asked: dict[str, list[distributed.Future]] = {}
        self.refused: dict[str, str] = {}
        self.fallen = 0  # workers that were lost before they were ready
        self.since = time.perf_counter()
        self.warned: set[str] = set()

    def turn_to(self, parcel: Parcel) -> None:
        """Goes on with another scene."""
        self.before = self.parcel.key if self.parcel.key != parcel.key else self.before
        self.parcel, self.fallen, self.since = parcel, 0, time.perf_counter()
        self.refused.clear()  # who could not take part is asked again

    def close(self) -> None:
        """Asks nobody any more."""
        for futures in self.asked.values():
            for future in futures:
                future.release()

    def ask(self, address: str) -> None:
        """Has a worker made ready."""

        async def greet() -> None:
            try:
                self.tell(address, await self._greeted(address))
            except Exception as error:  # noqa: BLE001 (whatever it is, the others go on)
                self.tell(address, error)

        self.asked[address] = []
        self.link.begin(greet())

    async def _greeted(self, address: str) -> worker.Greeting:
        """The greeting of a worker that is of our kind, and has the scene."""
        future = self.link.submit(address, worker.greet, self.variant, self.parcel.key)
        self.asked[address].append(future)
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
            if address in self.asked:
                self.asked[address].append(loading)
            if isinstance(error := await self.link.outcome(loading), BaseException):
                raise error
        return greeting

    def answered(self, address: str, greeting: worker.Greeting | Exception) -> worker.Greeting | None:
        """What was told of a worker; None where it does not take part."""
        if self.asked.pop(address, None) is None:
            return None  # it has gone
        if isinstance(greeting, Exception):
            if lost(greeting):  # it is asked again, if it is there
                self.fallen += 1
            else:
                self.refused[address] = f"{address}: {said(greeting)}"
                self._warn_once(f"a worker can't take part, {self.refused[address]}")
            return None
        if different := origin.differences(greeting.origin, self.ours, origin.CLOSE):
            self._warn_once(
                f"the worker {address} is of another kind ({different}): its samples are as good, but may differ in "
                "their last bits"
            )
        return greeting

    def look(self, present: frozenset[str], workers: Collection[str]) -> None:
        """Forgets who is not ``present`` any more, and asks who has come; ``workers``: that take part already.

        Raises ClusterError where none does, and too many were lost before they did.
        """
        for address in set(self.asked) - present:
            for future in self.asked.pop(address):
                future.release()
            self.fallen += 1
            if self.fallen >= LOSSES and not workers:
                raise ClusterError(
                    f"{LOSSES} workers were lost when they were given the scene; have they enough memory, and does "
                    "prosim doctor find nothing wrong there?"
                )
        for address in set(self.refused) - present:
            del self.refused[address]
        for address in present - set(workers) - set(self.asked) - set(self.refused):
            self.ask(address)

    def check(self) -> None:
        """Says it once where nobody has come yet. Raises ClusterError where nobody can take part. To be called while
        nobody does.
        """
        if not self.asked:
            if self.refused:
                raise ClusterError("no worker of the cluster can take part: " + "; ".join(self.refused.values()))
            if time.perf_counter() - self.since > PATIENCE:
                self._warn_once("the cluster has no workers yet; the render begins when there are some")

    def _warn_once(self, text: str) -> None:
        if text not in self.warned:
            self.warned.add(text)
            self.say(text)
