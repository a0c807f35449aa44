"""Which views a cell of a notebook has made: they end when it is run again, as nobody can see or stop them any more."""

from __future__ import annotations

from typing import Any, Protocol
from weakref import WeakSet


class Stoppable(Protocol):
    """What can be stopped."""

    def stop(self) -> None:
        """Ends it."""


#: Cell -> the run of it that was the last, and what that has made.
_made: dict[str, tuple[str, WeakSet[Stoppable]]] = {}


def made(view: Stoppable) -> None:
    """Says that the cell which runs now has made ``view``; stops what its earlier runs have made. Nothing where there
    is no notebook, or one that says nothing of its cells.
    """
    from IPython import get_ipython

    request: dict[str, Any] = getattr(get_ipython(), "get_parent", dict)()
    cell, run = request.get("metadata", {}).get("cellId"), request.get("header", {}).get("msg_id")
    if cell is None or run is None:
        return
    last, views = _made.get(cell, (None, WeakSet[Stoppable]()))
    if last != run:
        for earlier in views:
            earlier.stop()
        views = WeakSet()
        _made[cell] = run, views
    views.add(view)
