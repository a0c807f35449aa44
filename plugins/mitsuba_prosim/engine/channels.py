"""The channels of a film, and their values for a sample."""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi

from ..parameters import reject, text
from ..registry import create

#: Channels of statistics about the render; any other AOV is computed by Mitsuba's ``aov`` integrator.
OWN_AOVS = ("samples", "error")


def check_aovs(film: mi.Film, names: Sequence[str]) -> None:
    """Raises ValueError for AOVs ``names`` on a ``film`` of spectral bands: Mitsuba would end the process, or store
    zeros in scalar variants.
    """
    if names and mi.has_flag(film.flags(), mi.FilmFlags.Special):
        raise ValueError(f"{film.class_name()} stores spectral bands, without AOVs and layers; use an hdrfilm")


class Channels:
    """The channels of an image on ``film``.

    ``colours``, ``own_aovs`` and ``aovs`` are the integrator's parameter ``channels``, and the result of
    :func:`parse_aovs`. ``transport_aovs`` are the names of further channels that the light transport computes with the
    radiance, such as the layers of the image.
    """

    def __init__(
        self,
        film: mi.Film,
        colours: str,
        own_aovs: Sequence[str],
        aovs: mi.Integrator | None,
        transport_aovs: Sequence[str],
    ) -> None:
        self.film, self.stored_colours, self.own_aovs, self.aovs = film, colours, list(own_aovs), aovs
        self.special = mi.has_flag(film.flags(), mi.FilmFlags.Special)
        self.alpha = bool(mi.has_flag(film.flags(), mi.FilmFlags.Alpha))
        # The channels of a special film, such as ``specfilm``, have numbers as names.
        aov_names = [*transport_aovs, *(self.aovs.aov_names() if self.aovs is not None else ())]
        own = map(str, range(film.base_channels_count())) if self.special else "RGB" + "A" * self.alpha
        #: Names of the channels of a sample; ``W`` is the weight.
        self.names = [*own, "W", *aov_names]
        #: Names of the AOVs of the film, which follow its own channels.
        self.aov_names = aov_names + self.own_aovs
        if self.special and set(colours) != set("rgb"):
            raise ValueError(
                f'{film.class_name()} stores spectral bands, so channels = "{colours}" cannot choose colours'
            )
        check_aovs(film, self.aov_names)

    def values(self, L: mi.Spectrum, wavelengths: mi.Color0f, alpha: mi.Float) -> list[mi.Float]:
        """Returns the values of the film's own channels, without AOVs, for a sample whose filter weight is 1.

        The values are the colours, ``alpha`` if the film has an alpha channel, and the weight 1. A film with the flag
        ``Special``, such as ``specfilm``, computes the values itself. ``L`` is the radiance along the camera ray, times
        the weight of the ray.
        """
        if self.special:
            return list(self.film.prepare_sample(L, wavelengths, self.film.base_channels_count() + 1, 1.0, alpha))
        return [*self.rgb(L, wavelengths), *[alpha] * self.alpha, mi.Float(1)]

    def rgb(self, L: mi.Spectrum, wavelengths: mi.Color0f) -> list[mi.Float]:
        """Returns red, green and blue of ``L``, equal in monochromatic variants; an omitted colour is 0."""
        rgb = to_rgb(L, wavelengths)
        return [v if name in self.stored_colours else mi.Float(0) for name, v in zip("rgb", rgb)]

    def luminance(self, values: Sequence[mi.Float]) -> mi.Float:
        """Returns the luminance of a pixel, from the sums ``values`` of its channels, which are weighted by the filter.

        The last of the ``values`` is the sum of the filter's weights, by which the luminance is divided; the result is
        NaN if all ``values`` are 0. For a film with the flag ``Special``, such as ``specfilm``, the mean of all
        channels except the last replaces the luminance; it is divided by the weights, too.
        """
        light = sum(values[:-1]) / (len(values) - 1) if self.special else mi.luminance(mi.Color3f(*values[:3]))
        return light / values[-1]


def to_rgb(L: mi.Spectrum, wavelengths: mi.Color0f) -> mi.Color3f:
    """Returns the linear sRGB colour of ``L``; ``wavelengths`` in nm, empty except in spectral variants."""
    if mi.is_spectral:
        return mi.spectrum_to_srgb(L, wavelengths)
    return mi.Color3f(L.x) if mi.is_monochromatic else mi.Color3f(L)


def luminance(L: mi.Spectrum, wavelengths: mi.Color0f) -> mi.Float:
    """Returns the luminance of the radiance ``L``; the luminance of white is 1.

    In spectral variants, Mitsuba's function ``mi.luminance`` omits the division by the integral of the CIE curve y, so
    the result of ``mi.luminance`` is 107 times greater than the luminance.
    """
    return mi.spectrum_to_xyz(L, wavelengths).y if mi.is_spectral else mi.luminance(L, wavelengths)


def aov_values(
    aovs: mi.Integrator | None, scene: mi.Scene, sampler: mi.Sampler, ray: mi.RayDifferential3f, active: mi.Bool
) -> list:
    """Returns the AOVs of Mitsuba's integrator ``aovs`` along ``ray``; empty if ``aovs`` is None."""
    return [] if aovs is None else list(aovs.sample(scene, sampler, ray, None, active)[2])


def parse_aovs(props: mi.Properties) -> tuple[list[str], mi.Integrator | None]:
    """Reads the parameter ``aovs`` of a progressive integrator, and returns ``(own, mitsuba)``.

    ``own`` are the names of the AOVs that this package computes itself (:data:`OWN_AOVS`). ``mitsuba`` is an ``aov``
    integrator of Mitsuba that computes the AOVs with other names; None if there are no other names. Raises ValueError
    for a name that is neither in :data:`OWN_AOVS` nor has the form ``name:type``.
    """
    aovs = list(filter(None, map(str.strip, text(props, "aovs").split(","))))
    own, others = [aov for aov in aovs if aov in OWN_AOVS], [aov for aov in aovs if aov not in OWN_AOVS]
    if wrong := next((aov for aov in others if ":" not in aov), None):
        raise reject(props, "aovs", wrong, ", ".join(OWN_AOVS) + " or name:type as for the aov integrator")
    return own, create("aov", aovs=",".join(others)) if others else None
