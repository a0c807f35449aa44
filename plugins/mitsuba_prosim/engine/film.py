"""The channels of a film: the values of a sample, and the values of an image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from ..alone import alone
from ..compat import dr_array
from ..parameters import reject
from ..registry import create
from .plan import pixels

if TYPE_CHECKING:
    from .accumulators import Accumulators, FilmState

#: Channels of statistics about the render; any other AOV is computed by Mitsuba's ``aov`` integrator.
OWN_AOVS = ("samples", "error")


class Channels:
    """The channels that every sample of an image has: those of the film, and those of Mitsuba's ``aov`` integrator.

    ``stored_colours`` are the letters of "rgb" that the film stores. ``integrator_aovs`` are the names of further
    values that the integrator returns, such as layers. ``aovs`` is Mitsuba's ``aov`` integrator, or None.
    """

    def __init__(
        self, film: mi.Film, stored_colours: str, integrator_aovs: Sequence[str] = (), aovs: mi.Integrator | None = None
    ) -> None:
        self.film, self.stored_colours, self.aovs = film, stored_colours, aovs
        self.special = mi.has_flag(film.flags(), mi.FilmFlags.Special)
        self.alpha = bool(mi.has_flag(film.flags(), mi.FilmFlags.Alpha))
        mitsuba_aovs = list(aovs.aov_names()) if aovs is not None else []
        #: Names of the channels; ``W`` is the weight.
        self.names = (
            ([str(k) for k in range(film.base_channels_count())] if self.special else list("RGB") + ["A"] * self.alpha)
            + ["W"]
            + list(integrator_aovs)
            + mitsuba_aovs
        )

    @property
    def aov_names(self) -> list[str]:
        """Names of the AOVs, which follow the film's own channels."""
        return self.names[self.names.index("W") + 1 :]

    def values(
        self,
        scene: mi.Scene,
        sampler: mi.Sampler,
        ray: mi.Ray3f,
        L: mi.Spectrum,
        hit: mi.Float,
        integrator_values: Sequence[mi.Float] = (),
    ) -> list[mi.Float]:
        """Returns the values of all channels for a sample of weight 1.

        ``L`` is the radiance along the camera ray ``ray``, times the weight of the ray. ``hit`` is the alpha of the
        sample: 1 if the integrator reports a hit, else 0. ``integrator_values`` are further values that the integrator
        returned.
        """
        if self.special:
            values = self.film.prepare_sample(L, ray.wavelengths, self.film.base_channels_count() + 1, 1.0, hit)
        else:
            values = self.rgb(L, ray.wavelengths) + [hit] * self.alpha + [mi.Float(1)]
        return [*values, *integrator_values, *aov_values(self.aovs, scene, sampler, ray, True)]

    def rgb(self, L: mi.Spectrum, wavelengths: mi.Color0f) -> list[mi.Float]:
        """Returns red, green and blue of the radiance ``L``; a colour that is not stored is 0."""
        if mi.is_spectral:
            rgb = mi.spectrum_to_srgb(L, wavelengths)
        else:
            rgb = mi.Color3f(L.x) if mi.is_monochromatic else mi.Color3f(L)
        return [v if name in self.stored_colours else mi.Float(0) for name, v in zip("rgb", rgb)]

    def luminance(self, values: Sequence[mi.Float]) -> mi.Float:
        """Returns the luminance of the weighted sums ``values`` of a pixel, without the weight.

        If the film stores no colours, the result is the mean of the channels of the film.
        """
        light = sum(values[:-1]) / (len(values) - 1) if self.special else mi.luminance(mi.Color3f(*values[:3]))
        return light / values[-1]


def luminance(L: mi.Spectrum, wavelengths: mi.Color0f) -> mi.Float:
    """Returns the luminance of the radiance ``L``, which is 1 for white.

    In spectral variants, Mitsuba's own function lacks the constant that converts spectra to colours, so its result is
    107 times greater.
    """
    return mi.spectrum_to_xyz(L, wavelengths).y if mi.is_spectral else mi.luminance(L, wavelengths)


def aov_values(
    aovs: mi.Integrator | None, scene: mi.Scene, sampler: mi.Sampler, ray: mi.Ray3f, active: mi.Bool
) -> list:
    """Returns the AOVs of Mitsuba's ``aov`` integrator ``aovs`` along the camera ray ``ray``; none if
    ``aovs`` is None.
    """
    return [] if aovs is None else list(aovs.sample(scene, sampler, mi.RayDifferential3f(ray), None, active)[2])


def parse_aovs(props: mi.Properties) -> tuple[list[str], mi.Integrator | None]:
    """Reads the parameter ``aovs``, and returns ``(own, mitsuba)``.

    ``own`` are the names in :data:`OWN_AOVS`. ``mitsuba`` is an ``aov`` integrator of Mitsuba for the other names, or
    None. Raises ValueError for a name that is neither in :data:`OWN_AOVS` nor has the form ``name:type``.
    """
    own, others = [], []
    for aov in filter(None, (a.strip() for a in props.get("aovs", "").split(","))):
        if aov in OWN_AOVS:
            own.append(aov)
        elif ":" in aov:
            others.append(aov)
        else:
            raise reject(props, "aovs", aov, ", ".join(OWN_AOVS) + " or name:type as for the aov integrator")
    return own, create("aov", aovs=",".join(others)) if others else None


def append_channels(image: mi.TensorXf, more: int) -> mi.TensorXf:
    """Returns ``image``, shape (height, width, channels), with ``more`` further channels of zeros at the end."""
    return dr.concat((image, dr.zeros(mi.TensorXf, (*image.shape[:2], more))), axis=2) if more else image


def put(film: mi.Film, values: mi.TensorXf, aov_names: Sequence[str]) -> None:
    """Replaces the content of ``film``, which may be that of another image, by ``values``."""
    film.prepare(aov_names)
    film.put_block(mi.ImageBlock(values, mi.ScalarPoint2i(film.crop_offset()), border=False))


@alone()
def film_values(state: FilmState, own_aovs: Sequence[str], second: Accumulators | None = None) -> mi.TensorXf:
    """Returns the film's values of the image so far, shape (height, width, channels).

    The channels ``own_aovs`` are multiplied by the weight, as films expect. Pixels without samples are black.
    ``second`` has the accumulators of a complete second image, whose values are returned instead. Each pixel gathers
    the sums of the pixels within the filter's reach, row after row.
    """
    plan, names = state.plan, state.estimator.channels.names
    accumulators, outer = (state.accumulators, state.outer) if second is None else (second, state.plan.region)
    (left, top, right, bottom), reach = plan.window, plan.reach
    x, y = pixels(plan.window)
    offsets = range(-reach, reach + 1)
    own = {"samples": accumulators.count}
    if "error" in own_aovs:
        own["error"] = dr_array(accumulators.error(plan.n))
    totals = [mi.Float(0) for _ in names]
    first_x, first_y, last_x, last_y, x0, y0, width = (
        dr.opaque(mi.Int32, v) for v in (*plan.region, *outer[:2], outer[2] - outer[0])
    )
    own_index = (y - y0) * width + x - x0
    # The offsets are reversed, so that the source pixels (x - dx, y - dy) come row after row.
    for dy in reversed(offsets):
        for dx in reversed(offsets):
            sx, sy = x - dx, y - dy
            in_region = (sx >= first_x) & (sx < last_x) & (sy >= first_y) & (sy < last_y)
            source = mi.UInt32(own_index - dy * width - dx)
            count = dr.gather(mi.UInt32, accumulators.count, source, in_region)
            weight = dr.select(count > 0, dr.rcp(mi.Float(count)), 0)
            place = ((dy + reach) * (2 * reach + 1) + dx + reach) * len(names)
            for c, sums in enumerate(accumulators.sums[place : place + len(names)]):
                totals[c] = totals[c] + weight * dr.gather(mi.Float, sums, source, in_region)
    weight = totals[names.index("W")]
    totals += [weight * mi.Float(dr.gather(type(own[name]), own[name], mi.UInt32(own_index))) for name in own_aovs]
    values = dr.ravel(mi.ArrayXf(totals))
    dr.eval(values)
    return mi.TensorXf(values, (bottom - top, right - left, len(totals)))
