"""Absorption of light in glass and water by Beer's law (Hall 1988, chapter 6 of the thesis).

The interior ``mi.Medium`` of a shape describes the inside of the shape. The integrators support homogeneous media that
only absorb light, and ignore media that scatter light.
"""

from __future__ import annotations

from collections.abc import Iterator

import drjit as dr
import mitsuba as mi

from ..masks import idle
from ..optics.nested import all_shapes

#: Wavelengths in nm at which a medium is tested for scattering.
TESTED = (380.0, 450.0, 500.0, 550.0, 600.0, 650.0, 700.0, 780.0)

#: Length of a ray that meets nothing. A medium that absorbs light transmits nothing over this length.
UNBOUNDED = 1e30


def absorbs_any(scene: mi.Scene, camera_medium: mi.Medium | None) -> bool:
    """Tells whether a medium of ``scene`` or the medium of the camera absorbs light.

    Warns of media that scatter light or are not homogeneous, because the integrator ignores these media.
    """
    media = dict.fromkeys([*media_of(scene), *([] if camera_medium is None else [camera_medium])])
    absorbing = [medium for medium in media if only_absorbs(medium)]
    if len(absorbing) < len(media):
        others = ", ".join(repr(medium.id()) for medium in media if medium not in absorbing)
        mi.Log(
            mi.LogLevel.Warn,
            f"prosim: the media {others} scatter light or are not homogeneous, and are ignored. Give homogeneous media "
            'with albedo 0, or render with "volpath".',
        )
    return bool(absorbing)


def media_of(scene: mi.Scene) -> Iterator[mi.Medium]:
    """Yields the media inside and outside of all shapes of ``scene``, and of the shapes within instances."""
    for shape in all_shapes(scene):
        for medium in (shape.interior_medium(), shape.exterior_medium()):
            if medium is not None:
                yield medium


def only_absorbs(medium: mi.Medium) -> bool:
    """Tells whether ``medium`` is homogeneous and does not scatter light."""
    if not medium.is_homogeneous():
        return False
    for i in range(0, len(TESTED), 4):
        mei = dr.zeros(mi.MediumInteraction3f)
        if mi.is_spectral:
            mei.wavelengths = mi.UnpolarizedSpectrum(TESTED[i : i + 4])
        sigma_s, _, _ = medium.get_scattering_coefficients(mei, True)
        if dr.any(sigma_s != 0, axis=None):
            return False
    return True


def transmittance(
    medium: mi.MediumPtr | mi.Medium | None, wavelengths: mi.Color0f, t: mi.Float, active: mi.Bool
) -> mi.UnpolarizedSpectrum | float:
    """Returns the transmittance of ``medium`` over the distance ``t``.

    The transmittance is 1 without a medium, and in media that scatter light or are not homogeneous.
    """
    if medium is None:  # in scalar variants
        return 1.0
    mei = dr.zeros(mi.MediumInteraction3f)
    mei.wavelengths = wavelengths
    sigma_s, _, sigma_t = medium.get_scattering_coefficients(mei, active)
    absorbs = active & medium.is_homogeneous() & dr.all(sigma_s == 0, axis=0)
    return dr.select(absorbs, dr.exp(-sigma_t * t), 1)


def medium_beyond(
    si: mi.SurfaceInteraction3f, medium: mi.MediumPtr | mi.Medium | None, d: mi.Vector3f, active: mi.Bool
) -> mi.MediumPtr | mi.Medium | None:
    """Returns the medium of a ray that leaves ``si`` in the direction ``d``; the ray arrived in ``medium``.

    The medium stays the same if the surface has no media.
    """
    if idle(active):  # only in scalar variants
        return medium
    return dr.select(active & si.is_medium_transition(), si.target_medium(d), medium)


def medium_before(
    si: mi.SurfaceInteraction3f, medium: mi.MediumPtr | mi.Medium | None, d: mi.Vector3f, active: mi.Bool
) -> mi.MediumPtr | mi.Medium | None:
    """Returns the medium in which a camera ray of direction ``d`` arrives at ``si``.

    The medium is the sensor's ``medium``, or, without it, the medium that the surface has on the camera's side.
    """
    return medium_beyond(si, medium, -d, active & (medium == pointer(None)))


def pointer(medium: mi.Medium | None) -> mi.MediumPtr | mi.Medium | None:
    """Returns ``medium`` in the type that rays store: a Dr.Jit array, or ``medium`` itself in scalar variants."""
    return mi.MediumPtr(medium) if dr.is_jit_v(mi.Float) else medium
