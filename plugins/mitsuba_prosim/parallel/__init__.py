"""Rendering of one image, or of many, by the workers of a Dask cluster.

The bits of the image are those of a render by one process. ``bundle``: a scene in a form for workers; ``worker``: the
task of a worker; ``executor``: submits tasks; ``cluster``: workers on this machine, and schedulers elsewhere. The room
needs Dask, which the extra ``cluster`` installs, and is imported only when a user asks for workers.
"""

from .executor import ClusterError, DaskExecutor, render

__all__ = ["ClusterError", "DaskExecutor", "render"]
