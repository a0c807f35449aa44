"""Rendering of one image, or of many, by the workers of a Dask cluster.

The image has the same bits as an image that one process renders. The module ``bundle`` packs a scene for workers;
``worker`` has the task that a worker executes; ``executor`` submits tasks; ``cluster`` starts workers on this machine,
and connects to schedulers elsewhere. The modules of ``parallel`` need Dask, which the extra ``cluster`` installs. The
modules are imported only when a user asks for workers.
"""

from .executor import ClusterError, DaskExecutor, render

__all__ = ["ClusterError", "DaskExecutor", "render"]
