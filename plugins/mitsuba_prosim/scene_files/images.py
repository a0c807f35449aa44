"""A film's image as files: linear with how it was made, and as a screen shows it."""

from __future__ import annotations

from collections.abc import Mapping

import mitsuba as mi
import numpy as np

from . import session
from .tone import compress


def encode(bitmap: mi.Bitmap, facts: Mapping[str, str], exposure: float = 0.0) -> dict[str, bytes]:
    """Suffix -> content of an EXR, with ``facts`` as its metadata, and of a PNG.

    The PNG is ``2**exposure`` times as bright, its highlights compressed. A film without colours (spectral bins, say)
    has none.
    """
    for name, fact in facts.items():
        bitmap.metadata()[name] = fact
    with session.enough_threads():
        images = {".exr": _encoded(bitmap, mi.Bitmap.FileFormat.OpenEXR)}
    colours = next((layer for name, layer in bitmap.split() if name == "<root>"), bitmap)
    if colours.pixel_format() != mi.Bitmap.PixelFormat.MultiChannel:
        linear = colours.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False)
        shown = mi.Bitmap(compress(np.array(linear) * np.float32(2**exposure)))
        images[".png"] = _encoded(shown.convert(component_format=mi.Struct.Type.UInt8, srgb_gamma=True),
                                  mi.Bitmap.FileFormat.PNG)
    return images


def _encoded(bitmap, form):
    stream = mi.MemoryStream()
    bitmap.write(stream, form)
    return stream.raw_buffer()
