"""Renders one image or many images on the workers of a Dask cluster.

An image that workers render has the same bits as an image that one process renders, if all machines have the same kind
of processor. The module ``bundle`` packs a scene and its files, so that they can be sent to workers. The module
``worker`` has the task that a worker executes. The module ``executor`` submits work items as tasks to the cluster. The
module ``cluster`` starts workers on this machine, or connects to a scheduler elsewhere. The modules of ``parallel``
need Dask, which the extra ``cluster`` of this package installs. The modules of ``parallel`` are imported only when a
render uses workers, because Dask may be missing.
"""

from .executor import ClusterError, DaskExecutor, render

__all__ = ["ClusterError", "DaskExecutor", "render"]
