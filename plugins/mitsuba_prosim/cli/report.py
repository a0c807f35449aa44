"""The report of a render: the metadata of the EXR file, and the lines that the command prints at the end."""

from __future__ import annotations

import json
from math import isnan
from typing import TYPE_CHECKING, Any

from .. import __version__
from ..engine.render import Reached
from ..explaining.verdict import ERRORS, denoised_words, end_cause, verdict
from .job import Job

if TYPE_CHECKING:
    from ..denoising.final_image import FinalImage


def metadata(job: Job, integrator: Any, reached: Reached | None, ended: str | None, seconds: float) -> dict[str, str]:
    """Returns the metadata of an EXR image.

    ``reached`` is None if the render is not progressive; otherwise, there are entries for the mean number of samples
    per pixel and the measured errors. ``ended`` is the result of :func:`.end_cause`.
    """
    result = {"scene": job.scene, "version": __version__, "variant": job.variant, "integrator": str(integrator)}
    result |= {"seed": str(job.seed), "seconds": f"{seconds:.3f}"}
    if reached is not None:
        values = {name: getattr(reached, name) for name in ("samples", *ERRORS, "noise_at_most")}
        result |= {name: f"{value:.6g}" for name, value in values.items() if not isnan(value)}
    if ended is not None:
        result["ended"] = ended
    return {f"prosim.{name}": value for name, value in result.items()}


def summary(render: Any, final: FinalImage | None, interrupted: bool, integrator: Any, file: Any) -> str | None:
    """Returns a line with the verdict, the samples and the seconds of a render, for the arguments of :func:`.verdict`;
    None for a render with neither a target nor a ``final`` image of a denoiser.
    """
    reached = render.reached if end_cause(render) else None
    if reached is None:
        return None if final is None else denoised_words(final, interrupted)
    limit = f" of {render.target.seconds:g}" if render.target.seconds else ""
    words, stop, causes = verdict(render, final, interrupted, integrator, file).partition(". ")
    return f"{words}, {reached.samples:.1f} samples a pixel, {reached.seconds:.1f} s{limit}{stop}{causes}"


def denoised_facts(final: FinalImage, interrupted: bool) -> dict[str, str]:
    """Returns the metadata of the ``final`` image of a denoiser."""
    if interrupted and len(final.render.half_images()) == 1:
        return {"prosim.denoised": "no, interrupted"}
    from ..denoising import oidn

    result = final.denoised()
    facts = {
        "prosim.denoised": f"by Open Image Denoise {oidn.load().oidn_version()}, where two halves of the samples "
        "agree; the layers raw and denoised of the EXR are what was mixed",
        "prosim.denoised.noise": f"{result.noise:.6g}",
        "prosim.denoised.raw_noise": f"{result.raw_noise:.6g}",
    }
    if why := final.why_raw:
        facts["prosim.denoised"] = f"no: {why}"
    if final.render.reached and (estimates := final.render.state.estimates):
        facts["prosim.denoised.estimates"] = json.dumps(estimates)  # samples, ratio of the errors
    return facts
