"""A film's image as files: linear with how it was made, and as a screen shows it."""

from __future__ import annotations

import io
from collections.abc import Mapping

import mitsuba as mi
import numpy as np
import OpenEXR


def encode(
    bitmap: mi.Bitmap, facts: Mapping[str, str], exposure: float = 0.0, shown: Mapping[str, str] | None = None
) -> dict[str, bytes]:
    """Suffix -> content of an EXR, with ``facts`` as its metadata, and of a PNG, with those that are ``shown``.

    The PNG is ``2**exposure`` times as bright, its highlights compressed. A film without colours (spectral bins, say)
    has none.
    """
    images = {".exr": exr(bitmap, facts)}
    linear = colours(bitmap)
    if linear is not None:
        images[".png"] = png(compress(linear * np.float32(2**exposure)), shown)
    return images


def colours(bitmap: mi.Bitmap) -> np.ndarray | None:
    """The colours of a film's image, linear, shape (height, width, 3); None if it has none (spectral bins, say)."""
    layer = next((layer for name, layer in bitmap.split() if name == "<root>"), bitmap)
    if layer.pixel_format() == mi.Bitmap.PixelFormat.MultiChannel:
        return None
    return np.array(layer.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False))


def compress(rgb: np.ndarray) -> np.ndarray:
    """Compresses highlights to at most 1: the curve of Reinhard et al. (2002, equation 4) on the luminance.

    ``rgb``: linear radiance, shape (height, width, 3), white being 1. The luminance that one pixel in a hundred exceeds
    becomes white. An image within the range of the screen stays as it is. Ratios of the channels are kept, as far as
    they fit the screen.
    """
    luminance = np.maximum(rgb @ np.array([0.2126, 0.7152, 0.0722], dtype=rgb.dtype), 0)[..., None]
    white = max(1.0, float(np.percentile(luminance, 99)))
    return rgb * (1 + luminance / white**2) / (1 + luminance)


def exr(bitmap: mi.Bitmap, facts: Mapping[str, str]) -> bytes:
    """An OpenEXR file: the bitmap's channels under their names ("R", "nn.X"), in their precision, and ``facts``.

    By OpenEXR's own library: Mitsuba 3.9 waits for ever when it writes one with fewer than three threads.
    """
    if bitmap.component_format() not in (mi.Struct.Type.Float16, mi.Struct.Type.Float32, mi.Struct.Type.UInt32):
        bitmap = bitmap.convert(component_format=mi.Struct.Type.Float32, srgb_gamma=False)
    names = [field.name for field in bitmap.struct_()]
    width, height = bitmap.size()
    planes = np.moveaxis(np.array(bitmap).reshape(height, width, len(names)), 2, 0)
    # A file's name may hold bytes that are no text.
    header = {name: fact.encode("utf-8", "backslashreplace").decode("utf-8") for name, fact in facts.items()}
    header |= {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    file = io.BytesIO()
    OpenEXR.File(header, {name: np.ascontiguousarray(plane) for name, plane in zip(names, planes)}).write(file)
    return file.getvalue()


def png(image: np.ndarray, facts: Mapping[str, str] | None = None, effort: int = -1) -> bytes:
    """A PNG file of a linear image (height, width, 3), white being 1, in sRGB and 8 bits, with ``facts`` as text.
    ``effort``: of zlib, 1 to 9; -1 for what is usual.
    """
    stream = mi.MemoryStream()
    shown = mi.Bitmap(image).convert(component_format=mi.Struct.Type.UInt8, srgb_gamma=True)
    for name, fact in (facts or {}).items():
        shown.metadata()[name] = fact
    shown.write(stream, mi.Bitmap.FileFormat.PNG, effort)
    return stream.raw_buffer()
