"""The materials of section 5.1."""
