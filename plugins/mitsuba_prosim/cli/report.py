"""The report of a render: the metadata of the EXR file, and the lines that the command prints at the end."""

from __future__ import annotations

import json
from importlib.metadata import version
from math import isnan

import mitsuba as mi

from ..denoising import oidn
from ..denoising.final_error import TOLERANCE
from ..denoising.final_image import FinalImage
from ..engine.plan import UNLIMITED
from ..engine.render import Reached
from .job import Job

#: Noise measure (a parameter of an integrator, and a measured value of a render) -> its name in the report.
NOISES = {"noise": "noise", "noise_99": "noise of 99 % of the pixels", "noise_999": "noise of 99.9 %"}


def metadata(
    job: Job, integrator: mi.Integrator, reached: Reached | None, interrupted: bool, seconds: float
) -> dict[str, str]:
    """Returns the metadata of an EXR image.

    For a render that is not progressive, ``reached`` is None, and the following entries do not exist. The entry
    ``prosim.samples`` is the mean number of samples per pixel. The entries ``prosim.noise``, ``prosim.noise_99``,
    ``prosim.noise_999`` and ``prosim.noise_at_most`` exist if the render measured these errors. The entry
    ``prosim.ended`` is the result of :func:`end_cause`; if this result is None, the entry does not exist.
    """
    result = {
        "scene": job.scene,
        "version": version("mitsuba-prosim"),
        "variant": job.variant,
        "integrator": str(integrator),
        "seed": str(job.seed),
        "seconds": f"{seconds:.3f}",
    }
    if reached is not None:
        values = {name: getattr(reached, name) for name in ("samples", *NOISES, "noise_at_most")}
        result |= {name: f"{value:.6g}" for name, value in values.items() if not isnan(value)}
        if ended := end_cause(integrator, reached, interrupted):
            result["ended"] = ended
    return {f"prosim.{name}": value for name, value in result.items()}


def summary(
    integrator: mi.Integrator, reached: Reached, ended: str | None, noise_bound: float | None = None
) -> str | None:
    """Returns a line with the noise, the samples and the seconds of a render, and the cause of its end.

    ``ended`` is the result of :func:`end_cause`. If ``ended`` is None, this function returns None. ``noise_bound`` is
    an upper bound of the noise (the RMS error of the displayed image) for a render that did not measure the noise; None
    for other renders.
    """
    if ended is None:
        return None
    parts = []
    # After an interruption or a time limit, the noise was measured at an earlier image; the noise is now lower.
    below = "" if ended in ("noise", "samples") else "below "
    for name in noise_goals(integrator):
        measured = getattr(reached, name)
        value = "not known yet," if isnan(measured) else f"{below}{measured:.2g}"
        parts.append(f"{NOISES[name]} {value} of {getattr(integrator, name):g}")
        if name == "noise" and reached.uncertain:
            parts.append(f"uncertain: it may be {reached.noise_at_most:.2g}")
            if reached.tiny_lamp:
                parts[-1] += " or more, as glossy surfaces reflect a lamp smaller than a pixel"
    if noise_bound is not None:
        value = "not known" if isnan(noise_bound) else f"at most about {noise_bound:.2g}"
        parts.append(f"noise {value} (--noise measures it)")
    limit = f" of {integrator.time:g}" if integrator.time else ""
    parts += [f"{reached.samples:.1f} samples a pixel", f"{reached.seconds:.1f} s{limit}"]
    if ended == "samples":
        parts.append(f"ended by the maximum number of samples per pixel, {integrator.max_samples or UNLIMITED}")
    elif ended == "time" and noise_goals(integrator):
        parts.append("ended by the time")
    return ", ".join(parts)


def denoised_report(final: FinalImage, integrator: mi.Integrator, film: mi.Film) -> tuple[dict[str, str], str]:
    """Returns the metadata of a denoised image, and the line that the command prints about denoising.

    If the image without denoising (the raw image) has reached the error target of ``integrator``, the line says that
    the image was not denoised. The line also says if the error is uncertain, and if the filter of ``film`` is no box
    filter.
    """
    result, limit = final.denoised(), getattr(integrator, "noise", 0.0)
    facts = {
        "prosim.denoised": f"by Open Image Denoise {oidn.load().oidn_version()}, where two halves of the samples "
        "agree; the layers raw and denoised of the EXR are what was mixed",
        "prosim.denoised.noise": f"{result.noise:.6g}",
        "prosim.denoised.raw_noise": f"{result.raw_noise:.6g}",
    }
    line = f"denoised: noise about {result.noise:.2g}, raw {result.raw_noise:.2g}"
    if final.networks == "none":
        facts["prosim.denoised"] = "no, the raw image is within the limit"
        line = "not denoised: the raw image is within the limit"
    if final.render.reached and (estimates := final.render.state.estimates):
        facts["prosim.denoised.estimates"] = json.dumps(estimates)  # samples, networks, ratio of the errors
    if result.at_most > TOLERANCE * max(result.noise, limit):
        line += f", uncertain: its noise may be {result.at_most:.2g}"
    if not film.rfilter().is_box_filter():
        line += " (the film's filter is wider than a pixel; a box filter suits a denoiser better)"
    return facts, line


def noise_goals(integrator: mi.Integrator) -> list[str]:
    """Returns the names of those error parameters in :data:`NOISES` for which ``integrator`` has a limit."""
    return [name for name in NOISES if getattr(integrator, name, 0)]


def end_cause(integrator: mi.Integrator, reached: Reached, interrupted: bool) -> str | None:
    """Returns why a render has ended, as one of the words ``interrupted``, ``noise``, ``time`` and ``samples``.

    The word ``noise`` means that all errors are within their limits. The word ``samples`` means that the render has
    ended because the pixels have the maximum number of samples. The result is None if the integrator has neither an
    error target nor a time limit, even after an interruption.
    """
    noises = noise_goals(integrator)
    if not (noises or integrator.time):
        return None
    if interrupted:
        return "interrupted"
    if noises and all(getattr(reached, name) <= getattr(integrator, name) for name in noises):
        return "noise"
    return "time" if integrator.time and reached.samples < (integrator.max_samples or UNLIMITED) else "samples"
