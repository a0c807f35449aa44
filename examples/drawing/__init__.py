"""The thesis's figures, for ``figures.py``: curves of the optics, sampling patterns, and rendered scenes."""
