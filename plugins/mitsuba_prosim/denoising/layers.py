"""A denoised image as a film's: the final one, and beside it in layers what it came from."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from .denoised import Denoised
from .halves import Halves


def bitmap(halves: Halves, denoised: Denoised) -> mi.Bitmap:
    """The final image and the integrator's own channels, under their names; the layers ``raw`` and ``denoised``; and
    the errors of all three: ``error``, ``error_raw`` and ``error_denoised``, with one channel, ``Y``.
    """
    colours = halves.names[: halves.colours]
    planes = dict(zip(colours, np.moveaxis(denoised.final, 2, 0))) | halves.others()
    for layer, image in (("raw", denoised.raw), ("denoised", denoised.denoised)):
        planes |= {f"{layer}.{name}": plane for name, plane in zip(colours, np.moveaxis(image, 2, 0))}
    planes |= {
        "error.Y": denoised.final_error,
        "error_raw.Y": denoised.raw_error,
        "error_denoised.Y": denoised.denoised_error,
    }
    return of_channels(planes)


def undenoised(halves: Halves) -> mi.Bitmap:
    """The first half alone, where there is no second one."""
    return of_channels(dict(zip(halves.names, np.moveaxis(halves.first, 2, 0))))


def of_channels(planes: dict[str, np.ndarray]) -> mi.Bitmap:
    """A bitmap of named channels, each of shape (height, width)."""
    values = np.stack(list(planes.values()), axis=2, dtype=np.float32)
    return mi.Bitmap(values, mi.Bitmap.PixelFormat.MultiChannel, list(planes))
