"""The building block of procedural textures: textures that mix two textures by a pattern."""
