"""Long work that takes turns with whoever waits for it."""

from __future__ import annotations

import atexit
import threading
import weakref
from collections.abc import Callable


class LeftError(BaseException):
    """Nobody waits for the work any more."""


class Turns:
    """``work(pause)``, in a thread of its own that goes on only while :meth:`go_on` waits for it: until the work calls
    ``pause()``, or is over. The two never run at the same time.
    """

    def __init__(self, work: Callable[[Callable[[], None]], None]) -> None:
        self._theirs, self._ours = threading.Semaphore(0), threading.Semaphore(0)
        self._error: BaseException | None = None
        self._begun = self._left = self.over = False
        self._thread = threading.Thread(target=self._run, args=(work,), name="turns", daemon=True)
        _living.add(self)

    def go_on(self) -> bool:
        """A turn of the work; returns whether there is more of it. Raises what it raised."""
        if self.over:
            return False
        if self._begun:
            self._theirs.release()
        else:
            self._begun = True
            self._thread.start()
        try:
            self._ours.acquire()
        except BaseException:  # Ctrl-C: the turn has to end all the same
            self._ours.acquire()
            raise
        if self._error is not None:
            raise self._error
        return not self.over

    def leave(self) -> None:
        """Ends the work where it has paused, and waits for the end of its thread."""
        if self._begun and not self.over:
            self._left = True
            self._theirs.release()
            self._thread.join()

    def _pause(self) -> None:
        self._ours.release()
        self._theirs.acquire()
        if self._left:
            raise LeftError

    def _run(self, work: Callable[[Callable[[], None]], None]) -> None:
        try:
            work(self._pause)
        except LeftError:
            pass
        except BaseException as error:  # noqa: BLE001 (it is raised where the work is waited for)
            self._error = error
        finally:
            self.over = True
            self._ours.release()


#: Those that there are. A thread that is left in the midst of Dr.Jit's arrays when the interpreter dies may take the
#: process with it.
_living: weakref.WeakSet[Turns] = weakref.WeakSet()


@atexit.register
def _leave_all() -> None:
    for turns in list(_living):
        turns.leave()
