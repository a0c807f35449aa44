"""``prosim render --denoise``: two halves, what they make together, and what is said of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import click
import mitsuba as mi

from ..denoising import halves, layers, oidn
from ..engine.render import Reached
from .options import InputError

#: Channels of the raw and of the denoised image, and of the errors.
LAYERS = 9


@dataclass(frozen=True)
class Picture:
    """An image to be written. ``facts``: metadata, of the PNG too; ``said``: what is to be told of it; ``at_most``:
    what its noise is at most, about, where that is known without having been asked for.
    """

    bitmap: mi.Bitmap
    facts: Mapping[str, str] = field(default_factory=dict)
    said: str | None = None
    at_most: float | None = None
    #: How far the render came; None where the integrator does not say.
    reached: Reached | None = None


def check(film: mi.Film, integrator: mi.Integrator | None = None) -> None:
    """Raises ClickException where the package is missing, InputError where ``film`` stores no colours, and where the
    ``integrator`` denoises by itself: twice would be once too often.
    """
    if integrator is not None and "denoised.R" in integrator.aov_names():
        raise InputError("--denoise: the scene's integrator, prosim_denoised, denoises by itself; leave out --denoise.")
    try:
        oidn.load()
        halves.check(film)
    except oidn.MissingError as error:
        raise click.ClickException(f"--denoise: {error}") from None
    except ValueError as error:
        raise InputError(f"--denoise: {error}") from None


def denoise(render: halves.Rendering, film: mi.Film) -> Picture:
    """Denoises what was rendered; where that was stopped, the first half, or what there is of it, stays as it is."""
    both = render.halves
    if both.second is None:
        facts, said = {"prosim.denoised": "no, interrupted"}, "not denoised: interrupted"
        return Picture(layers.undenoised(both), facts, said, reached=render.reached)
    result = both.denoised()
    raw, final = result.noise(result.raw_error), result.noise(result.final_error)
    facts = {
        "prosim.denoised": f"by Open Image Denoise {oidn.load().oidn_version()}, as far as two halves of the samples "
        "agree with it; the layers raw and denoised of the EXR are what was mixed",
        "prosim.denoised.noise": f"{final:.6g}",
        "prosim.denoised.raw_noise": f"{raw:.6g}",
    }
    said = f"denoised: noise about {final:.2g}, raw {raw:.2g}"
    if not film.rfilter().is_box_filter():
        said += " (the film's filter is wider than a pixel: a denoiser can do more with a box filter)"
    return Picture(layers.bitmap(both, result), facts, said, reached=render.reached)
