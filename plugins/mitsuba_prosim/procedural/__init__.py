"""Building blocks of procedural textures: patterns, and textures that mix two textures by a pattern."""
