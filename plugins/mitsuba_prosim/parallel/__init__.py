"""One image, or many, by the workers of a Dask cluster; the bits are those of one process.

``bundle``: a scene for a worker; ``worker``: the tasks; ``executor``: hands them out; ``cluster``: workers of this
machine, and a scheduler elsewhere. All but ``bundle`` need Dask, the extra ``cluster``, and are imported when they are
asked for.
"""

from typing import Any

__all__ = ["ClusterError", "DaskExecutor", "render"]


def __getattr__(name: str) -> Any:
    """The names of ``executor``, which needs Dask."""
    if name in __all__:
        from . import executor

        return getattr(executor, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
