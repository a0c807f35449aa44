"""Says in words what a render has reached, and why it ended."""

from __future__ import annotations

import re
from contextlib import suppress
from functools import partial
from math import isnan, log2
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from ..compat import AOV, description, named_by
from ..engine.error_target import UNCERTAIN
from ..engine.policies import mean_around
from ..engine.render import Render
from ..engine.standard_error import in_display_units
from ..optics.nested import all_flags, all_shapes
from ..scene.black import (
    BLACK,
    RARE,
    clipped,
    depth_limit,
    has_media,
    hidden_lamp,
    lost_behind_glass,
    lost_by_mirrors,
    reason_by_rays,
    shows_back,
    unseen_medium,
)
from ..scene.images import luminance
from ..transport import lobes

if TYPE_CHECKING:
    from ..denoising.final_image import FinalImage

#: Errors with a limit (parameters of an integrator, and measured values of a render) -> their names in the verdict.
ERRORS = {"noise": "error", "noise_99": "error of 99 % of the pixels"}


#: Half of the error in at most this fraction of the pixels is a fault; and so is an error that is this large (white =
#: 1) without a limit, or this many times its limit, wherever it is.
FEW_PIXELS, LOUD, MISSED = 0.02, 0.05, 1.2
#: Number of further samples of a pixel that tell the cause, number of pixels that may lack it, seconds for it; and
#: number of pixels that need no time to be sorted by their errors.
FURTHER, ATTEMPTS, SECONDS, SMALL = 4096, 3, 1.0, 1 << 18
#: A median of the luminance that is too bright, and a luminance that is too dark for 95 %; white is 1. Integrators
#: without light.
BRIGHT, DARK, WITHOUT_LIGHT = 8.0, 0.01, (AOV, "DepthIntegrator")
#: A fraction of the pixels that is too large for negative values by the film's filter.
NEGATIVE = 0.1
#: A normal map that is not raw, in the description of a BSDF, and its mean; and a mean that is too low for normals.
NORMALS, TILTED = re.compile(r"normalmap = BitmapTexture\[(?:.*\n){3}\s*raw = 0,\s*mean = \[([^\],]+)"), 0.4
#: Mitsuba's integrators that ignore media.
SURFACES = ("PathIntegrator", "DirectIntegrator")
#: Functions that return a sentence on what the sensor sees.
VIEW = (clipped, unseen_medium, hidden_lamp, shows_back)


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
    render: Any,
    final: FinalImage | None = None,
    interrupted: bool = False,
    integrator: Any = None,
    file: Any = None,
    exposure: float = 0.0,
) -> str:
    """Returns the errors of the displayed image (white = 1) that a ``render`` has reached, and what ended it, in words.

    ``final`` is the final image of a render with a denoiser. The bound in brackets after an error holds in about 95 of
    100 renders. If the error is uncertain or large, the ``integrator`` of the render takes further samples, which tell
    the :func:`cause`, unless a time limit leaves too little time; None leaves the cause out. ``file`` is the file of
    the scene, whose names of shapes the cause uses, and ``exposure`` that of the picture in stops.
    """
    ended, late = end_cause(render, interrupted), why_late(render) if isinstance(render, Render) else ""
    parts = _errors(render, ended, file) if isinstance(render, Render) else []
    untold = not parts and (final is None or final.why_raw)
    if final is not None:
        parts.append(denoised_words(final, interrupted))
    if untold:
        bound = render.noise_bound() if isinstance(render, Render) else float("nan")
        known, why = f"at most about {bound:.2g} (an estimate; ", "unknown ("
        if tiny := isinstance(render, Render) and tiny_lamp(render, file):
            why += f"{tiny}; "
        parts.insert(0, f"error {why if tiny or isnan(bound) else known}a noise target would measure it)")
    if isinstance(render, Render) and render.state.estimator.transport.caustics is not None:
        parts.append("not counting the blur of photons")  # which is the same in both images
    if ended == "samples":
        parts.append(f"ended by the maximum number of samples per pixel, {most_samples(render)}")
    sentences = [", ".join(parts)]
    if integrator is not None and isinstance(render, Render):
        ignored = ignored_media(render)
        sentences += [ignored, too_shallow(render, integrator, file), negative(render)]
        seen = render.state.estimator.scene, render.state.estimator.sensor, partial(name_in, file)
        found = [partial(badly_exposed, render, file, exposure), partial(srgb_normals, render, file)]
        if not is_late(render) and np.max(light_of(render)) >= BLACK:
            found += [partial(lost, render, file)] + [partial(f, *seen) for f in VIEW]
        for told in found:
            with suppress(Exception):  # the image is finished, and must not be lost
                sentences.append(told())
        if is_doubtful(render, LOUD if final is None else np.inf) and not (interrupted or ignored):
            with suppress(Exception):
                sentences.append(cause(render, integrator, file))
    return ". ".join(filter(None, [*sentences, late])).replace("?. ", "? ")


def why_late(render: Render) -> str:
    """Returns a sentence that the compilation of kernels has exceeded the time limit; empty if it has not."""
    target, compiled = render.target, render.target.prepared + render.executor.launching
    late = target.seconds and max(0.05 * target.seconds, 0.2) < target.elapsed - target.seconds < compiled
    return f"Kernels were compiled for {compiled:.1f} s; the next such render finds them in a cache" if late else ""


def is_doubtful(render: Render, most: float) -> bool:
    """Tells whether few pixels have most of the error of the image, or whether the error is far above its limit, or
    above ``most`` without a limit; if ``most`` is infinite, only the former.
    """
    if not limits(render):
        return not render.noise_bound() <= most
    noise = render.state.noise
    concentrated = noise[2] > UNCERTAIN * noise[0]  # for a tiny lamp alone, the verdict has a reason
    return concentrated or (most < np.inf and not render.target.excess(noise) <= MISSED)


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
    if late:
        return told * few
    scene, sensor = render.state.estimator.scene, render.state.estimator.sensor
    media = has_media(scene, sensor) and "Vol" in nested_name(render)
    why: str | None = None
    for x, y in places:
        why = why_noisy(render, x, y, error, integrator, file, 2 if media else 8)
        if why and (not media or any(glass in why for glass in focusing(render, file))):
            return f"{told}: {why}"
    if media:
        fog = [name_in(file, shape) for shape in all_shapes(scene) if shape.is_medium_transition()]
        return f"{told}, and the medium in {' and '.join(fog[:2]) or 'the scene'} scatters or absorbs light"
    # One of few pixels may have met the only bright sample; the variance of many pixels is known.
    better = why == "" and not few and nested_name(render)
    return f"{told}; paths of prosim (--paths) would vary much less" if better else told * few


def why_noisy(
    render: Render, x: int, y: int, error: np.ndarray, integrator: Any, file: Any, less: float = 8
) -> str | None:
    """Returns which light makes a pixel noisy, and what would help, in words; empty if the variance of further samples
    is ``less`` times smaller and glass hides no lamp, None if the integrator has no samples that can be explained.
    """
    from . import noise  # few renders need these modules
    from .explanation import Samples, places

    samples, seed, estimator = int(render.counts()[y, x]), int(render.state.plan.seed[0]), render.state.estimator
    names, caustics = None if file is None else places(file), estimator.transport.caustics
    # The photons of one pass take about as long as those of the image.
    further = FURTHER if caustics is None else caustics.maps(FURTHER)
    level = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)  # that the samples ignore media is no fault of the image
    try:
        found = Samples(estimator.scene, (x, y), further, estimator.sensor, integrator, seed, names)
    except ValueError:
        return None
    finally:
        mi.set_log_level(level)
    deviations = np.square(found.luminance - found.luminance.mean())
    variance = samples * error[y, x] ** 2  # of a sample of the image, or of one bright sample among the others
    if deviations.mean() < variance / less and deviations.max() < samples * variance / (2 * less):
        return noise.rarely_met(found.recorder) if less > 2 else ""
    light, remedy = noise.worst(found.shares, found.recorder, found.deviations()[0])
    return f"{light}; what would help: {remedy}"


def nested_name(render: Render) -> str:
    """Returns the class of Mitsuba's integrator that finds the light; empty for the integrator prosim."""
    return description(getattr(render.state.estimator.transport, "integrator", "")).partition("[")[0]


def ignored_media(render: Render) -> str:
    """Returns a sentence that Mitsuba's integrator ignores the media of the scene; empty if it does not."""
    name, estimator = nested_name(render), render.state.estimator
    media = name in SURFACES and has_media(estimator.scene, estimator.sensor)
    return f"{name} ignores the media of the scene: take volpath" if media else ""


def too_shallow(render: Render, integrator: Any, file: Any = None) -> str:
    """Returns a sentence that rays end within glass, or that mirrors show only lamps, because the ``integrator`` limits
    the depth of rays; empty if not.
    """
    limit, deepest = depth_limit(render.state.estimator.scene.integrator() or integrator)  # in the words of the scene
    scene, sensor, shapes = render.state.estimator.scene, render.state.estimator.sensor, focusing(render, file)
    if deepest < 2 and lobes.has_any(all_flags(scene), *lobes.THROUGH):  # a ray enters and leaves
        return f"Within glass, {limit} ends rays: allow more reflections"
    if deepest < 3 and "Vol" in nested_name(render) and has_media(scene, sensor):
        return f"Within media, {limit} ends rays: allow more scattering"
    mirrors = f"In mirrors, such as {''.join(shapes[:1])}, {limit} shows only lamps: allow more reflections"
    return mirrors if deepest < 1 and shapes else ""


def light_of(render: Render) -> np.ndarray:
    """Returns the luminance of the image so far, shape (height, width)."""
    colours = np.array(render.image())
    return luminance(colours[..., :3]) if colours.shape[2] >= 3 else colours[..., 0]


def badly_exposed(render: Render, file: Any = None, exposure: float = 0.0) -> str:
    """Returns a sentence that the picture is much brighter than white, or almost black, and why; empty if not."""
    light = light_of(render) * 2.0**exposure
    middle, most, brightest = map(float, np.percentile(light, [50, 95, 100]))
    if nested_name(render) in WITHOUT_LIGHT or not limits(render):
        return ""
    if BRIGHT < middle < np.inf:
        return (
            f"Half of the picture is brighter than {middle:.2g}, white being 1: dim all lights by 2^{log2(middle):.0f}"
        )
    if brightest < BLACK or most > DARK or is_late(render):
        return ""
    scene, sensor = render.state.estimator.scene, render.state.estimator.sensor
    if scene.emitters() and (why := reason_by_rays(scene, sensor, partial(name_in, file), RARE)):
        return (
            f"95% of the picture is darker than {max(most, BLACK):.2g}, white being 1: mostly, {why.removesuffix('.')}"
        )
    told = f"The picture is darker than {brightest:.2g}, white being 1: brighten all lights by 2^{-log2(brightest):.0f}"
    return told if brightest < DARK else ""  # there are pictures of the night


def srgb_normals(render: Render, file: Any = None) -> str:
    """Returns a sentence that a normal map is read as colours; empty if none is."""
    for shape in all_shapes(render.state.estimator.scene):
        found = NORMALS.search(description(shape.bsdf())) if shape.bsdf() else None
        if found and (mi.is_spectral or float(found[1]) < TILTED):
            return (
                f"The normal map of {name_in(file, shape)} is read as colours (sRGB), so it tilts: set its raw to true"
            )
    return ""


def name_in(file: Any, shape: mi.Shape) -> str:
    """Returns the name of a shape in the ``file`` of the scene, with the line; None: as Mitsuba names it."""
    from .explanation import places  # few renders need it
    from .recorder import title

    return title(shape, "", {key: name for key, (name, _) in places(file).items()} if file else {})


def tiny_lamp(render: Render, file: Any = None) -> str:
    """Returns the words that rays may miss a lamp, and where; empty if they meet it."""
    if not render.reached.tiny_lamp:
        return ""
    lamp, by = name_in(file, named_by(render.tiny_lamp)), focusing(render, file)
    return f"rays may miss a small lamp, {lamp}, in mirrors or behind glass" + ", such as " * bool(by) + "".join(by[:1])


def focusing(render: Render, file: Any = None) -> list[str]:
    """Returns the names of the shapes of glass, of mirrors, and of a rough metal if it is the only one."""
    things = [(shape, int(shape.bsdf().flags())) for shape in all_shapes(render.state.estimator.scene) if shape.bsdf()]
    metals = [
        (one, f) for one, f in things if lobes.has_any(f, *lobes.REFLECTED) and not lobes.has_any(f, *lobes.DIFFUSE)
    ]
    found = [shape for shape, flags in things if lobes.has_any(flags, *lobes.THROUGH)]
    found += [shape for shape, flags in metals if len(metals) == 1 or lobes.has_any(flags, "DeltaReflection")]
    return [name_in(file, shape) for shape in dict.fromkeys(found)]


def is_late(render: Render) -> bool:
    """Tells whether a time limit leaves too little time to look for a cause."""
    limit, needed = render.target.seconds, SECONDS + render.executor.launching  # kernels as large as those of the image
    return bool(limit and render.target.elapsed + needed > 1.05 * limit)


def lost(render: Render, file: Any = None) -> str:
    """Returns a sentence that the image lacks light of lamps behind glass and masks; empty if not, and if a time limit
    leaves too little time to know.
    """
    estimator, name = render.state.estimator, nested_name(render)
    transport, scene = estimator.transport, estimator.scene
    paths = name != "DirectIntegrator" and not getattr(getattr(transport, "settings", None), "follows_tree", False)
    points = any(mi.has_flag(lamp.flags(), mi.EmitterFlags.Delta) for lamp in scene.emitters())
    known = name in ("", *SURFACES) or "Vol" in name
    if transport.caustics or not known or is_late(render) or (paths and not points):
        return ""
    seen, told = (scene, estimator.sensor), list[str]()
    if lobes.has_any(all_flags(scene), *lobes.REFRACTED):
        told.append(lost_behind_glass(*seen, paths, partial(name_in, file), "Vol" in name))
    if points:
        told.append(lost_by_mirrors(*seen, partial(name_in, file)))
    return ". ".join(filter(None, told))


def negative(render: Render) -> str:
    """Returns a sentence that much of the image is negative, not only edges that a filter sharpens; empty if not."""
    share = np.mean(light_of(render) < 0)
    cause = "a texture, material or lamp has negative values"
    return f"{share:.0%} of the pixels are negative: {cause}" if share > NEGATIVE else ""


def _errors(render: Render, ended: str | None, file: Any = None) -> list[str]:
    """Returns the measured errors that have a limit, in words."""
    reached, parts = render.reached, list[str]()
    # After an interruption or a time limit, the error was measured at an earlier image; the error is now lower.
    below = "" if ended in ("noise", "samples") else "below "
    for name, limit in limits(render).items():
        measured = getattr(reached, name)
        known = f"not measured yet (limit: {limit:g})" if isnan(measured) else f"{below}{measured:.2g} of {limit:g}"
        parts.append(f"{ERRORS[name]} {known}")
        if name == "noise" and reached.uncertain:
            tiny = tiny_lamp(render, file)
            parts.append(f"uncertain: it may be {f'much more, as {tiny}' if tiny else f'{reached.noise_at_most:.2g}'}")
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
