"""When files are saved."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

import watchfiles

#: Milliseconds without a further change after which those that there were are told, and within which they are.
QUIET, LONGEST = 20, 200


@contextmanager
def watched(path: Path, names: Callable[[], Collection[str]], tell: Callable[[], None]) -> Iterator[None]:
    """Calls ``tell``, in a thread, whenever a file in the folder of ``path`` is written, made, removed or renamed that
    has one of these ``names`` then; or in that of the file which ``path`` is a link to.

    The folder is watched, not the file: many editors save a new file and rename it.
    """
    folders = {path.absolute().parent, path.resolve().parent}
    end = threading.Event()

    def follow() -> None:
        for found in watchfiles.watch(
            *folders,
            watch_filter=None,
            debounce=LONGEST,
            step=QUIET,
            rust_timeout=0,
            stop_event=end,
            recursive=False,
            raise_interrupt=False,
        ):
            if {Path(path).name for _, path in found} & set(names()):
                tell()

    thread = threading.Thread(target=follow, name="changes", daemon=True)
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join(1)
