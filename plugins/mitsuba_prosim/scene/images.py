"""Encodes the image of a film as the content of an EXR file and of a PNG file."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from hashlib import blake2b

import mitsuba as mi
import numpy as np
import OpenEXR

#: Keys in the metadata of an EXR file: the :func:`checksum` of the EXR file itself, with :data:`UNKNOWN` in the place
#: of the checksum, and the checksum of the PNG file of the same image.
CHECKSUM, PNG_CHECKSUM = "prosim.checksum", "prosim.png_checksum"


def checksum(content: bytes) -> str:
    """Returns a hash of the ``content`` of a file, which has 32 hexadecimal digits."""
    return blake2b(content, digest_size=16).hexdigest()


#: Names of the channels of a film's colours -> their format.
COLOURS = {name: getattr(mi.Bitmap.PixelFormat, name) for name in ("RGB", "XYZ", "Y")}

#: A text of the same length as a checksum.
UNKNOWN = checksum(b"")

#: Matches the checksum in the content of an EXR file.
STORED = re.compile(CHECKSUM.encode() + rb"\0string\0\x20\0\0\0([0-9a-f]{32})")


def encode(
    bitmap: mi.Bitmap, facts: Mapping[str, str], exposure: float = 0.0, shown: Mapping[str, str] | None = None
) -> dict[str, bytes]:
    """Returns the contents of an EXR file with the metadata ``facts`` and of a PNG file with the metadata ``shown``:
    suffix of the file -> content. A film without colours has no PNG.

    The PNG is brighter by ``exposure`` stops, with highlights that :func:`compress` has compressed, and clipped. The
    EXR has the values of the film, and a :func:`checksum` of the PNG.
    """
    linear = colours(bitmap)
    if linear is None:
        return {".exr": exr(bitmap, facts)}
    display = png(compress(linear * np.float32(2**exposure)), shown)
    return {".exr": exr(bitmap, {**facts, PNG_CHECKSUM: checksum(display)}), ".png": display}


def colours(bitmap: mi.Bitmap) -> np.ndarray | None:
    """Returns the linear colours of a film's image, shape (height, width, 3), without AOVs; None if the film stores
    values that are not colours, such as spectral bins. Grey values and XYZ colours are converted to RGB.
    """
    # Names of AOVs have several letters; not all have the dot by which ``bitmap.split`` knows them.
    own = {field.name: k for k, field in enumerate(bitmap.struct_()) if len(field.name) == 1 and field.name != "A"}
    kind = next((kind for kind in COLOURS if own.keys() == {*kind}), None)
    if kind is None:
        return None
    pixels = np.ascontiguousarray(np.atleast_3d(np.array(bitmap))[..., [own[letter] for letter in kind]])
    layer = mi.Bitmap(pixels, COLOURS[kind])
    return np.array(layer.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False))


def luminance(rgb: np.ndarray) -> np.ndarray:
    """Returns the luminance, shape (...), of linear colours, shape (..., 3), by ITU-R BT.709, to four decimals."""
    return rgb @ np.array([0.2126, 0.7152, 0.0722], dtype=rgb.dtype)


def compress(rgb: np.ndarray) -> np.ndarray:
    """Returns the image ``rgb`` with compressed highlights, by the tone curve of Reinhard and others (2002, equation
    4).

    ``rgb`` is linear, shape (height, width, 3), with white at 1. The curve is applied to the luminance, so the ratios
    of red, green and blue do not change. It maps the 99th percentile of the image's luminance to 1, or 1 if the
    percentile is below 1. The image does not change if the percentile is at most 1, or if the image contains NaN.
    """
    light = np.maximum(luminance(rgb), 0)[..., None]
    white = max(1.0, float(np.percentile(light, 99)))
    return rgb * (1 + light / white**2) / (1 + light)


def exr(bitmap: mi.Bitmap, facts: Mapping[str, str]) -> bytes:
    """Returns the content of an OpenEXR file with the channels of ``bitmap``, in its precision, and the metadata
    ``facts``.

    The OpenEXR library writes the file, because Mitsuba 3.9 hangs when it writes an EXR file with fewer than three
    threads.
    """
    pixels = np.atleast_3d(np.array(bitmap))
    # The name of a file may contain bytes that are not UTF-8.
    header = {name: fact.encode("utf-8", "backslashreplace").decode("utf-8") for name, fact in facts.items()}
    header |= {CHECKSUM: UNKNOWN, "compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    channels = {field.name: np.ascontiguousarray(pixels[..., k]) for k, field in enumerate(bitmap.struct_())}
    file = io.BytesIO()
    OpenEXR.File(header, channels).write(file)
    content = file.getvalue()
    return content.replace(UNKNOWN.encode(), checksum(content).encode(), 1)


def is_whole(content: bytes) -> bool | None:
    """Tells whether the ``content`` of an EXR file agrees with its checksum, so that each bit is that of :func:`exr`;
    None if the file has no checksum, so that another program has written it.
    """
    if (stored := STORED.search(content)) is None:
        return None
    unsigned = content[: stored.start(1)] + UNKNOWN.encode() + content[stored.end(1) :]
    return checksum(unsigned).encode() == stored[1]


def png(image: np.ndarray, facts: Mapping[str, str] | None = None) -> bytes:
    """Returns the content of a PNG file (sRGB, 8 bits) with a linear image, shape (height, width, 3); values outside
    [0, 1] are clipped. ``facts`` are the metadata.
    """
    stream = mi.MemoryStream()
    shown = mi.Bitmap(image).convert(component_format=mi.Struct.Type.UInt8, srgb_gamma=True)
    for name, fact in (facts or {}).items():
        shown.metadata()[name] = fact
    shown.write(stream, mi.Bitmap.FileFormat.PNG)
    return stream.raw_buffer()
