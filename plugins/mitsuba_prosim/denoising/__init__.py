"""The honest denoiser: it says where it is wrong, and gives way to the samples.

``oidn``: the denoiser; ``mixing``: how far it is followed;
``denoised``: both together; ``halves``: from a scene to two images and their features; ``layers``: as a film's image.
"""

from .denoised import Denoised, denoise
from .halves import render

__all__ = ["Denoised", "denoise", "render"]
