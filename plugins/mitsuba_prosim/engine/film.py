"""The channels of a film: the values of a sample, and those of an image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from ..alone import alone
from ..compat import dr_array
from ..parameters import reject
from ..registry import create
from .plan import index_within, pixels

if TYPE_CHECKING:
    from .accumulators import Accumulators, FilmState

#: Channels that say how the image was made; any other AOV is one of Mitsuba's ``aov`` integrator.
OWN_AOVS = ("samples", "error")


class Channels:
    """The channels that every sample of an image has: the film's own and those of Mitsuba's ``aov`` integrator.

    ``stored_colours``: the letters of "rgb" that the film stores; ``integrator_aovs``: names of the further values that
    the integrator returns, such as layers; ``aovs``: Mitsuba's ``aov`` integrator, or None.
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
        """The values of a sample of weight 1: the radiance ``L`` along the camera ray ``ray``, which ``hit`` a
        surface, and the ``integrator_values``.
        """
        if self.special:
            values = self.film.prepare_sample(L, ray.wavelengths, self.film.base_channels_count() + 1, 1.0, hit)
        else:
            values = self.rgb(L, ray.wavelengths) + [hit] * self.alpha + [mi.Float(1)]
        return [*values, *integrator_values, *aov_values(self.aovs, scene, sampler, ray, True)]

    def rgb(self, L: mi.Spectrum, wavelengths: mi.Color0f) -> list[mi.Float]:
        """Red, green and blue of the radiance ``L``; 0 for those that are not stored."""
        if mi.is_spectral:
            rgb = mi.spectrum_to_srgb(L, wavelengths)
        else:
            rgb = mi.Color3f(L.x) if mi.is_monochromatic else mi.Color3f(L)
        return [v if name in self.stored_colours else mi.Float(0) for name, v in zip("rgb", rgb)]

    def luminance(self, values: Sequence[mi.Float]) -> mi.Float:
        """The luminance of the film's weighted sums ``values``, up to the weight; where the film stores no colours, the
        mean of its channels.
        """
        light = sum(values[:-1]) / (len(values) - 1) if self.special else mi.luminance(mi.Color3f(*values[:3]))
        return light / values[-1]


def luminance(L: mi.Spectrum, wavelengths: mi.Color0f) -> mi.Float:
    """Luminance of the radiance ``L``, that of the film's values; white has 1.

    Mitsuba's own lacks the constant by which spectra are made colours, and is 107 times as much there.
    """
    return mi.spectrum_to_xyz(L, wavelengths).y if mi.is_spectral else mi.luminance(L, wavelengths)


def aov_values(
    aovs: mi.Integrator | None, scene: mi.Scene, sampler: mi.Sampler, ray: mi.Ray3f, active: mi.Bool
) -> list:
    """The AOVs of Mitsuba's ``aov`` integrator ``aovs`` along the camera ray ``ray``; none if ``aovs`` is None."""
    return [] if aovs is None else list(aovs.sample(scene, sampler, mi.RayDifferential3f(ray), None, active)[2])


def parse_aovs(props: mi.Properties) -> tuple[list[str], mi.Integrator | None]:
    """The AOVs that the parameter ``aovs`` names: ``(own, mitsuba)``, the names in :data:`OWN_AOVS` and an ``aov``
    integrator of Mitsuba's for the others, if there are any. Raises ValueError where it is neither.
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
    """``image``, shape (height, width, channels), with ``more`` further channels of zeros at the end."""
    return dr.concat((image, dr.zeros(mi.TensorXf, (*image.shape[:2], more))), axis=2) if more else image


def put(film: mi.Film, values: mi.TensorXf, aov_names: Sequence[str]) -> None:
    """Replaces the content of ``film``, which may be that of another image, by ``values``."""
    film.prepare(aov_names)
    film.put_block(mi.ImageBlock(values, mi.ScalarPoint2i(film.crop_offset()), border=False))


@alone()
def film_values(state: FilmState, own_aovs: Sequence[str], second: Accumulators | None = None) -> mi.TensorXf:
    """The film's values of the image so far, shape (height, width, channels), with the ``own_aovs`` multiplied by the
    weight, as films expect. Pixels without samples are black. ``second``: those of a complete second image instead.

    Each pixel gathers the sums of the pixels within the filter's reach, row after row.
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
    own_index = mi.Int32(index_within(outer, x, y))
    first_x, first_y, last_x, last_y, width = (dr.opaque(mi.Int32, v) for v in (*plan.region, outer[2] - outer[0]))
    for dy in reversed(offsets):
        for dx in reversed(offsets):
            sx, sy = x - dx, y - dy
            there = (sx >= first_x) & (sx < last_x) & (sy >= first_y) & (sy < last_y)
            source = mi.UInt32(own_index - dy * width - dx)
            count = dr.gather(mi.UInt32, accumulators.count, source, there)
            weight = dr.select(count > 0, dr.rcp(mi.Float(count)), 0)
            place = ((dy + reach) * (2 * reach + 1) + dx + reach) * len(names)
            for c, sums in enumerate(accumulators.sums[place : place + len(names)]):
                totals[c] = totals[c] + weight * dr.gather(mi.Float, sums, source, there)
    weight = totals[names.index("W")]
    totals += [weight * mi.Float(dr.gather(type(own[name]), own[name], mi.UInt32(own_index))) for name in own_aovs]
    values = dr.ravel(mi.ArrayXf(totals))
    dr.eval(values)
    return mi.TensorXf(values, (bottom - top, right - left, len(totals)))
