"""The thesis's figures, for ``figures.py``: curves of the optics, sampling patterns, and rendered scenes.

``curves`` and ``patterns`` compute what ``optics`` and ``sampling`` draw; the notebooks use them as well.
"""
