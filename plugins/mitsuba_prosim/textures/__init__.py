"""The procedural textures of the scene palito, as plugins: brick, stripes and fractal noise; and a product of
textures.
"""
