"""The light sources of section 5.2 of the thesis, as emitter plugins."""
