"""Says in words what a render has reached, and why it ended."""

from __future__ import annotations

from contextlib import suppress
from math import isnan, log2
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from ..compat import AOV, description, name_of
from ..engine.error_target import UNCERTAIN
from ..engine.policies import mean_around
from ..engine.render import Render
from ..engine.standard_error import in_display_units
from ..optics.nested import all_flags, all_shapes
from ..scene.black import BLACK, depth_limit, lost_behind_glass
from ..scene.images import luminance
from ..transport import lobes

if TYPE_CHECKING:
    from ..denoising.final_image import FinalImage

#: Errors with a limit (parameters of an integrator, and measured values of a render) -> their names in the verdict.
ERRORS = {"noise": "error", "noise_99": "error of 99 % of the pixels"}


TINY_LAMP = " or more, as rays may miss a small lamp in mirrors or behind glass"
#: Half of the error in at most this fraction of the pixels is a fault; and so is an error that is this large (white =
#: 1) and this many times its limit, wherever it is.
FEW_PIXELS, LOUD, MISSED = 0.02, 0.05, 3.0
#: Number of further samples of a pixel that tell the cause, number of pixels that may lack it, and seconds for it; and
#: number of pixels that need no time to be sorted by their errors.
FURTHER, ATTEMPTS, SECONDS, SMALL = 4096, 3, 1.5, 1 << 18
#: A median of the luminance that is too bright, and a maximum that is too dark; white is 1. Integrators without light.
BRIGHT, DARK, WITHOUT_LIGHT = 8.0, 0.01, (AOV, "DepthIntegrator")
#: A fraction of the pixels that is too large for negative values by the film's filter.
NEGATIVE = 0.1
#: Mitsuba's integrators that ignore media.
SURFACES = ("PathIntegrator", "DirectIntegrator")


def limits(render: Render) -> dict[str, float]:
    """Returns the limits of errors of a render: name of a parameter in :data:`ERRORS` -> limit."""
    return {name: limit for name, limit in zip(ERRORS, render.target.limits) if limit}


def end_cause(render: Any, interrupted: bool = False) -> str | None:
    """Returns why a render has ended, as one of the words ``interrupted``, ``noise``, ``time`` and ``samples``.

    The word ``noise`` means that all errors are within their limits. The word ``samples`` means that each pixel has the
    maximum number of samples. The result is None if the render has neither an error target nor a time limit, even after
    an interruption.
    """
    if not isinstance(render, Render) or not render.state.plan.sampling.has_target:
        return None
    if interrupted:
        return "interrupted"
    reached, limited = render.reached, limits(render)
    if limited and all(getattr(reached, name) <= limit for name, limit in limited.items()):
        return "noise"
    return "time" if render.target.seconds and reached.samples < most_samples(render) else "samples"


def most_samples(render: Render) -> int:
    """Returns the maximum number of samples of a pixel, in both images of a render with a denoiser."""
    complete = render.second is not None and render.second.complete
    return render.state.plan.max_samples * (1 + complete)


def verdict(
    render: Any, final: FinalImage | None = None, interrupted: bool = False, integrator: Any = None, file: Any = None
) -> str:
    """Returns the errors of the displayed image (white = 1) that a ``render`` has reached, and what ended it, in words.

    ``final`` is the final image of a render with a denoiser. The bound in brackets after an error holds in about 95 of
    100 renders. If the error is uncertain or large, the ``integrator`` of the render takes further samples, which tell
    the :func:`cause`, unless a time limit leaves too little time; None leaves the cause out. ``file`` is the file of
    the scene, whose names of shapes the cause uses.
    """
    ended, late = end_cause(render, interrupted), why_late(render) if isinstance(render, Render) else ""
    parts = _errors(render, ended) if isinstance(render, Render) else []
    if final is not None:
        parts.append(denoised_words(final, interrupted))
    elif not parts:
        bound = render.noise_bound() if isinstance(render, Render) else float("nan")
        known = f"at most about {bound:.2g}{TINY_LAMP * render.reached.tiny_lamp} (an estimate; "
        parts = [f"error {'unknown (' if isnan(bound) else known}a noise target would measure it)"]
    if isinstance(render, Render) and render.state.estimator.transport.caustics is not None:
        parts.append("not counting the blur of photons")  # which is the same in both images
    if ended == "samples":
        parts.append(f"ended by the maximum number of samples per pixel, {most_samples(render)}")
    sentences = [", ".join(parts)]
    if integrator is not None and isinstance(render, Render):
        ignored = ignored_media(render)
        sentences += [ignored, too_shallow(render, integrator), badly_exposed(render), negative(render)]
        with suppress(Exception):  # the image is finished, and must not be lost
            sentences.append(lost(render, file))
        if is_doubtful(render, LOUD if final is None else np.inf) and not (interrupted or ignored):
            with suppress(Exception):
                sentences.append(cause(render, integrator, file))
    return ". ".join(filter(None, [*sentences, late]))


def why_late(render: Render) -> str:
    """Returns a sentence that the compilation of kernels has exceeded the time limit; empty if it has not."""
    target, compiled = render.target, render.target.prepared + render.executor.launching
    late = target.seconds and max(0.05 * target.seconds, 0.2) < target.elapsed - target.seconds < compiled
    return f"Kernels were compiled for {compiled:.1f} s; the next such render finds them in a cache" if late else ""


def is_doubtful(render: Render, most: float) -> bool:
    """Tells whether few pixels have most of the error of the image, or whether the error is above ``most`` and, if
    there is a limit, far above it.
    """
    if not limits(render):
        return not render.noise_bound() <= most
    noise = render.state.noise
    concentrated = noise[2] > UNCERTAIN * noise[0]  # for a tiny lamp alone, the verdict has a reason
    return concentrated or not (noise[0] <= most or render.target.excess(noise) <= MISSED)


def cause(render: Render, integrator: Any, file: Any = None) -> str:
    """Returns which pixels have half of the error, and which light makes such a pixel noisy, in words; empty if this is
    more than the fraction :data:`FEW_PIXELS` of the pixels and the light is unknown.

    Further samples of the pixel tell the light, unless they vary much less than those of the image. A time limit of a
    render may leave no time for them.
    """
    late, error = is_late(render), np.float64(render.error())
    if late and error.size > SMALL:
        return ""
    light = light_of(render)
    squares = np.square(in_display_units(error, np.minimum(light, mean_around(light, 2))))
    if not squares.sum() > 0:  # NaN, if a pixel has one sample
        return ""
    order = np.argsort(-squares, axis=None)
    count = int(np.searchsorted(np.cumsum(squares.ravel()[order]), squares.sum() / 2)) + 1
    few = count <= FEW_PIXELS * squares.size
    pixels = order[:ATTEMPTS] if few else order[count // 2 :][:ATTEMPTS]
    places = [(int(i) % squares.shape[1], int(i) // squares.shape[1]) for i in pixels[:count]]
    such = "{},{}".format(*places[0])
    told = f"{count if few else f'{count / squares.size:.0%} of the'} pixels, such as {such}, have half of the error"
    if count == 1:
        told = f"The pixel {such} has half of the error"
    if has_media(render) and "Vol" in nested_name(render):
        return f"{told}, and media scatter light"
    if late:
        return told * few
    why: str | None = None
    for x, y in places:
        if why := why_noisy(render, x, y, error, integrator, file):
            return f"{told}: {why}"
    # One of few pixels may have met the only bright sample; the variance of many pixels is known.
    better = why == "" and not few and nested_name(render)
    return f"{told}; paths of prosim (--paths) would vary much less" if better else told * few


def why_noisy(render: Render, x: int, y: int, error: np.ndarray, integrator: Any, file: Any) -> str | None:
    """Returns which light makes a pixel noisy, and what would help, in words; empty if further samples vary much less
    and glass hides no lamp, None if the integrator has no samples that can be explained.
    """
    from . import noise  # few renders need these modules
    from .explanation import Samples, places

    samples, seed, estimator = int(render.counts()[y, x]), int(render.state.plan.seed[0]), render.state.estimator
    names, caustics = None if file is None else places(file), estimator.transport.caustics
    # The photons of one pass take about as long as those of the image.
    further = FURTHER if caustics is None else caustics.maps(FURTHER)
    try:
        found = Samples(estimator.scene, (x, y), further, estimator.sensor, integrator, seed, names)
    except ValueError:
        return None
    deviations = np.square(found.luminance - found.luminance.mean())
    variance = samples * error[y, x] ** 2  # of a sample of the image, or of one bright sample among the others
    if deviations.mean() < variance / 8 and deviations.max() < samples * variance / 16:
        return noise.rarely_met(found.recorder)
    light, remedy = noise.worst(found.shares, found.recorder, found.deviations()[0])
    return f"{light}; what would help: {remedy}"


def nested_name(render: Render) -> str:
    """Returns the class of Mitsuba's integrator that finds the light; empty for the integrator prosim."""
    return description(getattr(render.state.estimator.transport, "integrator", "")).partition("[")[0]


def has_media(render: Render) -> bool:
    """Tells whether the scene has participating media."""
    scene, sensor = render.state.estimator.scene, render.state.estimator.sensor
    return sensor.get_medium() is not None or any(shape.is_medium_transition() for shape in all_shapes(scene))


def ignored_media(render: Render) -> str:
    """Returns a sentence that Mitsuba's integrator ignores the media of the scene; empty if it does not."""
    name = nested_name(render)
    return f"{name} ignores the media of the scene: take volpath" if name in SURFACES and has_media(render) else ""


def too_shallow(render: Render, integrator: Any) -> str:
    """Returns a sentence that rays end within glass, because the ``integrator`` limits their depth; empty if not."""
    limit, deepest = depth_limit(integrator)
    if deepest >= 2:  # a ray enters glass and leaves it
        return ""
    glass = (shape for shape in all_shapes(render.state.estimator.scene) if shape.bsdf() is not None)
    solid = any(lobes.has_any(int(shape.bsdf().flags()), *lobes.THROUGH) for shape in glass)
    return f"{limit} ends rays within glass: allow more reflections" if solid else ""


def light_of(render: Render) -> np.ndarray:
    """Returns the luminance of the image so far, shape (height, width)."""
    colours = np.array(render.image())
    return luminance(colours[..., :3]) if colours.shape[2] >= 3 else colours[..., 0]


def badly_exposed(render: Render) -> str:
    """Returns a sentence that the image is much brighter than white, or almost black; empty if not."""
    light = light_of(render)
    middle, most = float(np.median(light)), float(np.max(light))
    if nested_name(render) in WITHOUT_LIGHT or not limits(render):
        return ""
    if BRIGHT < middle < np.inf:
        return (
            f"Half of the picture is brighter than {middle:.2g}, white being 1: dim all lights by 2^{log2(middle):.0f}"
        )
    if BLACK <= most < DARK:
        return f"The picture is darker than {most:.2g}, white being 1: brighten all lights by 2^{-log2(most):.0f}"
    return ""


def name_in(file: Any, shape: mi.Shape) -> str:
    """Returns the name of a shape in the ``file`` of the scene, with the line; None: as Mitsuba names it."""
    from .explanation import places  # few renders need it

    return places(file).get(shape.id(), (name_of(shape),))[0] if file else name_of(shape)


def is_late(render: Render) -> bool:
    """Tells whether a time limit leaves too little time to look for a cause."""
    limit = render.target.seconds
    return bool(limit and render.target.elapsed + SECONDS > 1.05 * limit)


def lost(render: Render, file: Any = None) -> str:
    """Returns a sentence that the image lacks light of lamps behind glass and masks; empty if not, and if a time limit
    leaves too little time to know.
    """
    estimator, name = render.state.estimator, nested_name(render)
    transport, scene = estimator.transport, estimator.scene
    paths = name != "DirectIntegrator" and not getattr(getattr(transport, "settings", None), "follows_tree", False)
    points = any(mi.has_flag(lamp.flags(), mi.EmitterFlags.Delta) for lamp in scene.emitters())
    if transport.caustics or name not in ("", *SURFACES) or is_late(render) or (paths and not points):
        return ""
    glass = lobes.has_any(all_flags(scene), *lobes.REFRACTED)
    return lost_behind_glass(scene, estimator.sensor, paths, lambda shape: name_in(file, shape)) if glass else ""


def negative(render: Render) -> str:
    """Returns a sentence that much of the image is negative, not only edges that a filter sharpens; empty if not."""
    share = np.mean(light_of(render) < 0)
    cause = "a texture, material or lamp has negative values"
    return f"{share:.0%} of the pixels are negative: {cause}" if share > NEGATIVE else ""


def _errors(render: Render, ended: str | None) -> list[str]:
    """Returns the measured errors that have a limit, in words."""
    reached, parts = render.reached, list[str]()
    # After an interruption or a time limit, the error was measured at an earlier image; the error is now lower.
    below = "" if ended in ("noise", "samples") else "below "
    for name, limit in limits(render).items():
        measured = getattr(reached, name)
        known = f"not measured yet (limit: {limit:g})" if isnan(measured) else f"{below}{measured:.2g} of {limit:g}"
        parts.append(f"{ERRORS[name]} {known}")
        if name == "noise" and reached.uncertain:
            parts.append(f"uncertain: it may be {reached.noise_at_most:.2g}")
            if reached.tiny_lamp:
                parts[-1] += TINY_LAMP
        elif name == "noise" and not below:
            parts[-1] += f" (95 %: below {reached.noise_at_most:.3g})"
    return [f"reached the time limit at {parts[0]}", *parts[1:]] if parts and ended == "time" else parts


def denoised_words(final: FinalImage, interrupted: bool = False) -> str:
    """Returns the errors of a denoised image, or why the ``final`` image is not denoised, in words."""
    if interrupted and len(final.render.half_images()) == 1:
        return "not denoised: interrupted"
    if why := final.why_raw:
        return f"not denoised: {why}"
    from ..denoising.final_error import TOLERANCE  # only a render with a denoiser imports it
    from ..denoising.final_image import has_wide_filter

    result = final.denoised()
    limit = final.render.target.limits[0] if isinstance(final.render, Render) else 0.0
    known = result.noise > result.at_most / 4  # an estimate near 0 says little
    error = f"about {result.noise:.2g}" if known else f"at most {result.at_most:.2g}"
    words = f"denoised: error {error}, raw {result.raw_noise:.2g}"
    if known and result.at_most > TOLERANCE * max(result.noise, limit):
        words += f", uncertain: its error may be {result.at_most:.2g}"
    if has_wide_filter(final.denoiser.sensor):
        words += " (the film's filter is wider than a pixel; a box filter suits a denoiser better)"
    return words
