"""Absorption of light in glass and water by Beer's law (Hall 1988; thesis, chapter 6).

The interior ``mi.Medium`` of a shape is the medium inside the shape, such as glass or water. The integrators support
homogeneous media that only absorb light, and ignore media that scatter light or are not homogeneous.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import drjit as dr
import mitsuba as mi

from ..compat import warn_of
from ..masks import idle
from ..optics.nested import all_shapes, parts
from . import lobes

#: Albedo below which a medium does not scatter light. The maximum of a black spectrum may be 3e-8, a rounding error.
MIN_ALBEDO = 1e-6

#: The medium around a ray, or none, in the type of :attr:`.Ray.medium`.
AnyMedium: TypeAlias = "mi.MediumPtr | mi.Medium | None"

#: Length of a ray that meets nothing. A medium that absorbs light transmits nothing over this length.
UNBOUNDED = 1e30


def absorbs_any(scene: mi.Scene, camera_medium: mi.Medium | None) -> bool:
    """Tells whether ``camera_medium`` or a medium of ``scene`` only absorbs light; warns of media that are ignored."""
    media = dict.fromkeys([*media_of(scene), *([] if camera_medium is None else [camera_medium])])
    warn_of(
        (medium for medium in media if not only_absorbs(medium)),
        "the media {} scatter light or are not homogeneous, and are ignored. Give homogeneous media with albedo 0, or "
        'render with "volpath".',
    )
    return any(map(only_absorbs, media))


def warn_of_shadows(scene: mi.Scene, lamps: Sequence[mi.Emitter]) -> None:
    """Warns of media whose surface lets rays pass straight on, but not the light of ``lamps``, which only shadow rays
    find.
    """
    media = [s for s in all_shapes(scene) if s.is_medium_transition() and s.bsdf() is not None]
    if lamps:
        warn_of(
            (shape for shape in media if lobes.has_any(shape.bsdf().flags(), "Null")),
            "shadow rays end at {}, unlike in volpath, so the light of points and single directions, and in a ray tree "
            "of all lamps, does not pass there.",
        )


def media_of(scene: mi.Scene) -> list[mi.Medium]:
    """Returns the media on both sides of all shapes of ``scene``, including the shapes within instances."""
    media = (medium for s in all_shapes(scene) for medium in (s.interior_medium(), s.exterior_medium()))
    return [medium for medium in media if medium is not None]


def only_absorbs(medium: mi.Medium) -> bool:
    """Tells whether ``medium`` is homogeneous and does not scatter light."""
    albedo = parts(medium).get("albedo") if medium.is_homogeneous() else None
    return albedo is not None and albedo.max() < MIN_ALBEDO


def transmittance(
    medium: AnyMedium, wavelengths: mi.Color0f, t: mi.Float, active: mi.Bool
) -> mi.UnpolarizedSpectrum | float:
    """Returns the fraction of light that ``medium`` does not absorb over the distance ``t`` in scene units; 1 without a
    medium that :func:`only_absorbs`, and in lanes that are not ``active``. ``wavelengths`` are in nm; empty except in
    spectral variants.
    """
    if medium is None:
        return 1.0
    mei = dr.zeros(mi.MediumInteraction3f)
    mei.wavelengths = wavelengths
    sigma_s, _, sigma_t = medium.get_scattering_coefficients(mei, active)
    absorbs = active & medium.is_homogeneous() & dr.all(sigma_s <= MIN_ALBEDO * sigma_t, axis=0)
    return dr.select(absorbs, dr.exp(-sigma_t * t), 1)


def medium_beyond(si: mi.SurfaceInteraction3f, medium: AnyMedium, d: mi.Vector3f, active: mi.Bool) -> AnyMedium:
    """Returns the medium around a ray that leaves the surface point ``si`` in the direction ``d``.

    It is ``medium``, around the ray that arrived at ``si``, if the surface has no media, and in lanes that are not
    ``active``. In vectorised variants, None means that no medium of the scene absorbs light.
    """
    if idle(active) or (medium is None and dr.is_jit_v(mi.Float)):
        return medium
    return dr.select(active & si.is_medium_transition(), si.target_medium(d), medium)


def medium_before(si: mi.SurfaceInteraction3f, medium: AnyMedium, d: mi.Vector3f, active: mi.Bool) -> AnyMedium:
    """Returns the medium around a camera ray, or around a photon from a light source, that arrives at ``si`` in the
    direction ``d``: ``medium``, or in ``active`` lanes without one the medium on this side of the surface.
    """
    return medium_beyond(si, medium, -d, active & (medium == pointer(None)))


def pointer(medium: mi.Medium | None) -> AnyMedium:
    """Returns ``medium`` (or null) in the type of :attr:`.Ray.medium`: itself in scalar variants."""
    return mi.MediumPtr(medium) if dr.is_jit_v(mi.Float) else medium
