"""Denoises an image, mixes the denoised image with the raw image, and estimates the error of the result.

``oidn`` calls Open Image Denoise, ``mixing`` mixes both images at the scales of ``pyramid``, and ``denoise`` combines
these steps. ``halves`` denoises the halves of a render, ``final_error`` measures the error of the final image during
the render, and ``final_image`` returns this image and its layers.
"""

from .denoise import denoise
from .denoised import Denoised
from .final_image import render

__all__ = ["Denoised", "denoise", "render"]
