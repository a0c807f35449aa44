"""One image by several machines: whoever takes its samples, they are the same.

``remote``: who takes them; of each ``errand`` there is a ticket at the ``desk``, which somebody of the ``fleet`` is
given. ``joining``: how workers come to take part, ``sets``: which of them draws which photons, ``link``: how they are
reached, and ``faults``: what may go wrong. ``worker``: what they do, and ``message`` and ``parcel``: what travels.
``local``: a cluster of this machine; ``notebook``: an image in Python.

What needs Dask, the extra ``cluster``, is imported when it is asked for.
"""

from typing import Any

__all__ = ["ClusterError", "Remote", "render"]


def __getattr__(name: str) -> Any:
    """``render`` and others, which need Dask."""
    if name == "render":
        from .notebook import render

        return render
    if name == "ClusterError":
        from .faults import ClusterError

        return ClusterError
    if name == "Remote":
        from .remote import Remote

        return Remote
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
