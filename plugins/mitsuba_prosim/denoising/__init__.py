"""A denoiser that estimates its error and mixes its output with the samples.

``oidn``: the denoiser; ``mixing``: the mixture, by a ``pyramid`` of scales; ``denoised``: both together; ``halves``:
two images of a scene and their features; ``layers``: the result as a bitmap or in a film.
"""

from .denoised import denoise
from .halves import render
from .mixing import Denoised

__all__ = ["Denoised", "denoise", "render"]
