"""What can go wrong with a cluster, and how that is told apart from what goes wrong with the work."""

from __future__ import annotations

import distributed
from distributed.comm.core import CommClosedError

#: So many workers may be lost, less one, that are at the same samples, or at loading the scene.
LOSSES = 10


class ClusterError(RuntimeError):
    """A cluster that can't render the image."""


def lost(error: BaseException) -> bool:
    """Whether it was not the work that went wrong, but the worker that went."""
    return isinstance(error, (distributed.KilledWorker, distributed.CancelledError, CommClosedError))


def said(error: BaseException) -> str:
    """Why a worker can't take part."""
    if isinstance(error, (ImportError, AttributeError)):
        return f"it has no mitsuba-prosim of this version, or not all that it needs ({error})"
    return str(error) or type(error).__name__
