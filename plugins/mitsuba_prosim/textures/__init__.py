"""The procedural textures of the thesis's example scene (``examples/palito.scn``), as plugins: brick, stripes and
fractal noise; and a product of textures.
"""
