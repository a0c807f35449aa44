"""Denoises an image, mixes the denoised image with the raw image, and estimates the error of the result.

The module ``oidn`` calls Open Image Denoise. The module ``mixing`` mixes the raw and the denoised image separately at
several scales, which the module ``pyramid`` computes. The module ``denoise`` denoises two independent images of a
scene and mixes the result. The module ``halves`` renders the albedo and the normals for the denoiser, and denoises the
halves of a render. The module ``final_error`` measures the error of the final image during a render, and
``final_image`` returns the final image. The module ``layers`` stores the final image and its layers in a bitmap or in a
film.
"""

from .denoise import denoise
from .denoised import Denoised
from .final_image import render

__all__ = ["Denoised", "denoise", "render"]
