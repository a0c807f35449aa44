"""Intel's Open Image Denoise, called through the package ``mitsuba-oidn``."""

from __future__ import annotations

from types import ModuleType

import numpy as np
from prosim_scene import extras

from .pyramid import unevenness


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
    threads. ``fast`` selects smaller neural networks.
    """

    #: Minimum :func:`.unevenness` of an albedo with textures.
    TEXTURE = 0.05

    def __init__(self, albedo: np.ndarray | None = None, normal: np.ndarray | None = None, fast: bool = False) -> None:
        """Denoises the features, because denoised features preserve more of a texture; if ``fast`` is true, only an
        albedo with textures. Raises :class:`MissingError` without ``mitsuba-oidn``.
        """
        self.oidn = load()
        self.device = self.oidn.Device(self.oidn.DeviceType.CPU)
        self.quality = self.oidn.Quality.Fast if fast else self.oidn.Quality.High
        given = {"albedo": albedo, "normal": normal}
        self.features = {name: np.ascontiguousarray(x, dtype=np.float32) for name, x in given.items() if x is not None}
        #: Whether the denoiser of the image may assume that the features have no noise.
        self.clean = albedo is not None and not (fast and unevenness(albedo) < self.TEXTURE)
        if self.clean:
            self.features |= {name: self._denoised(name) for name in (("albedo",) if fast else self.features)}

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """Returns the denoised ``image``, linear, of shape (height, width, 1 or 3)."""
        colours = np.ascontiguousarray(np.broadcast_to(image, (*image.shape[:2], 3)), dtype=np.float32)
        how = {"hdr": True, "clean_aux": self.clean, "quality": self.quality, "device": self.device}
        result = np.array(self.oidn.denoise(colours, **self.features, **how))
        return result.mean(2, keepdims=True) if image.shape[2] == 1 else result

    def _denoised(self, name: str) -> np.ndarray:
        """Returns a feature, denoised by the fastest network, which is as good for features as the best one."""
        result = np.empty_like(self.features[name])
        work = self.device.new_filter("RT")
        work.quality = self.oidn.Quality.Fast
        work.set_image(name, self.features[name])
        work.set_image("output", result)
        work.execute()
        return result
