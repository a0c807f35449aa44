"""The parts of procedural textures: patterns, and the mixing of two textures by a pattern."""
