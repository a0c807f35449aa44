"""Intel's Open Image Denoise, called through the package ``mitsuba-oidn``."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
from prosim_scene import extras


class MissingError(ImportError):
    """The package ``mitsuba-oidn`` is not installed."""


def load() -> ModuleType:
    """Imports and returns ``mitsuba_oidn``; raises :class:`MissingError`, which names the package to install."""
    try:
        import mitsuba_oidn
    except ImportError as error:
        raise MissingError(f"{extras.needs('denoising', 'denoise')} ({error})") from None
    return mitsuba_oidn


class Denoiser:
    """Calls Open Image Denoise with the features (albedo and normals) of one view of a scene.

    The features are the albedo in [0, 1] and the normals in [-1, 1], arrays of shape (height, width, 3), or None. The
    denoiser runs on the CPU in all variants of Mitsuba. The last bits of the denoised image depend on the number of
    threads. ``fast`` selects smaller neural networks; the features are then used without being denoised first.
    """

    def __init__(self, albedo: np.ndarray | None = None, normal: np.ndarray | None = None, fast: bool = False) -> None:
        """Denoises the features, unless ``fast`` is true; raises :class:`MissingError` without ``mitsuba-oidn``."""
        self.oidn = load()
        self.device = self.oidn.Device(self.oidn.DeviceType.CPU)
        quality = self.oidn.Quality
        # Denoised features preserve more of a texture than noisy features. The best network is worth its time for the
        # albedo and for the image; for normals the fastest network is equally good.
        #: Whether the denoiser of the image may assume that the features have no noise.
        self.clean = albedo is not None and not fast
        self.albedo = self._feature("albedo", albedo, None if fast else quality.High)
        self.normal = self._feature("normal", normal, None if fast else quality.Fast)
        self.quality = quality.Fast if fast else quality.High

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """Returns the denoised ``image``, linear, of shape (height, width, 1 or 3)."""
        colours = np.ascontiguousarray(np.broadcast_to(image, (*image.shape[:2], 3)), dtype=np.float32)
        result = self.oidn.denoise(
            colours, self.albedo, self.normal, hdr=True, clean_aux=self.clean, quality=self.quality, device=self.device
        )
        return np.array(result).mean(2, keepdims=True) if image.shape[2] == 1 else np.array(result)

    def _feature(self, kind: str, feature: np.ndarray | None, quality: Any) -> np.ndarray | None:
        """Returns ``feature`` (albedo or normals), denoised if ``quality`` is not None; None for None."""
        if feature is None:
            return None
        feature = np.ascontiguousarray(feature, dtype=np.float32)
        if quality is None:
            return feature
        result = np.empty_like(feature)
        work = self.device.new_filter("RT")
        work.quality = quality
        work.set_image(kind, feature)
        work.set_image("output", result)
        work.execute()
        return result
