"""One image by several machines: whoever takes its samples, they are the same.

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
