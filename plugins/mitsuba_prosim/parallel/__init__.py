"""Renders images on the workers of a Dask cluster.

An image that workers render has the same bits as an image that one process renders, if all machines have the same kind
of processor. The modules are imported only when a render uses workers, because the extra ``cluster``, which has Dask,
may be missing.
"""
