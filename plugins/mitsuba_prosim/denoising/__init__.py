"""A denoiser that estimates its own error, and mixes the denoised image with the samples.

``oidn``: the denoiser; ``mixing``: the mixture, with the scales of ``pyramid``; ``denoised``: denoiser and mixture
together; ``halves``: two independent images of a scene and their features; ``layers``: the result as a bitmap or in a
film.
"""

from .denoised import denoise
from .halves import render
from .mixing import Denoised

__all__ = ["Denoised", "denoise", "render"]
