"""The materials of section 5.1 of the thesis, as BSDF plugins."""
