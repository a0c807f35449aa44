"""One image, or many, by the workers of a Dask cluster; the bits are those of one process.

``bundle``: a scene for a worker; ``worker``: the task; ``executor``: hands tasks out; ``cluster``: workers of this
machine, and a scheduler elsewhere. It needs Dask, the extra ``cluster``, and is imported when it is asked for.
"""

from .executor import ClusterError, DaskExecutor, render

__all__ = ["ClusterError", "DaskExecutor", "render"]
