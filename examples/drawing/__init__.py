"""The thesis's figures, for ``figures.py``: optical curves, sampling patterns, and rendered scenes.

``optics`` draws the curves that ``curves`` computes, and ``sampling`` draws the patterns of ``patterns``. The notebooks
use ``curves`` and ``patterns``, too.
"""
