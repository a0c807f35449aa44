"""What the procedural textures are made of: waves, noise, and the mixing of two textures by a pattern."""
