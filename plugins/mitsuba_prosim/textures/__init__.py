"""Procedural textures of the palito scene: brick, stripes, fractal."""
