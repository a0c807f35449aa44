"""A denoiser that estimates the error of its result, and mixes the denoised image with the samples.

The module ``oidn`` calls the denoiser. ``mixing`` mixes the images at the scales of ``pyramid``. ``denoised`` combines
the denoiser and the mixture. ``halves`` renders two independent images of a scene and the features. ``layers`` stores
the result in a bitmap or in a film.
"""

from .denoised import denoise
from .halves import render
from .mixing import Denoised

__all__ = ["Denoised", "denoise", "render"]
