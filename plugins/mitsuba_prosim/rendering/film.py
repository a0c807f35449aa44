"""What a film stores of a sample: its channels."""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi


class Channels:
    """The channels that every sample of an image has: the film's own and those of Mitsuba's ``aov`` integrator.

    ``letters``: which of r, g and b are kept; ``nested``: names of what comes with the radiance; ``aovs``: Mitsuba's
    ``aov`` integrator, or None.
    """

    def __init__(
        self, film: mi.Film, letters: str, nested: Sequence[str] = (), aovs: mi.Integrator | None = None
    ) -> None:
        self.film, self.letters, self.aovs = film, letters, aovs
        self.special = mi.has_flag(film.flags(), mi.FilmFlags.Special)
        self.alpha = bool(mi.has_flag(film.flags(), mi.FilmFlags.Alpha))
        others = list(aovs.aov_names()) if aovs is not None else []
        #: Names of the channels; ``W`` is the weight.
        self.names = (
            ([str(k) for k in range(film.base_channels_count())] if self.special else list("RGB") + ["A"] * self.alpha)
            + ["W"]
            + list(nested)
            + others
        )

    def values(
        self,
        scene: mi.Scene,
        sampler: mi.Sampler,
        ray: mi.Ray3f,
        L: mi.Spectrum,
        hit: mi.Float,
        nested: Sequence[mi.Float] = (),
    ) -> list[mi.Float]:
        """The values of a sample of weight 1: the radiance ``L`` along the camera ray ``ray``, which ``hit`` a
        surface, and what came with it.
        """
        return (
            self._own_values(L, ray.wavelengths, hit) + list(nested) + aov_values(self.aovs, scene, sampler, ray, True)
        )

    def _own_values(self, L: mi.Spectrum, wavelengths: mi.Color0f, alpha: mi.Float) -> list[mi.Float]:
        if self.special:
            return list(self.film.prepare_sample(L, wavelengths, self.film.base_channels_count() + 1, 1.0, alpha))
        if mi.is_spectral:
            rgb = mi.spectrum_to_srgb(L, wavelengths)
        else:
            rgb = mi.Color3f(L.x) if mi.is_monochromatic else mi.Color3f(L)
        rgb = [v if name in self.letters else mi.Float(0) for name, v in zip("rgb", rgb)]
        return rgb + [alpha] * self.alpha + [mi.Float(1)]


def aov_values(
    aovs: mi.Integrator | None, scene: mi.Scene, sampler: mi.Sampler, ray: mi.Ray3f, active: mi.Bool
) -> list:
    """What Mitsuba's ``aov`` integrator ``aovs`` (or None) computes at the camera ray ``ray``."""
    return [] if aovs is None else list(aovs.sample(scene, sampler, mi.RayDifferential3f(ray), None, active)[2])
