"""Says in words what a render has reached, and why it ended."""

from __future__ import annotations

from math import isnan
from typing import Any

from ..engine.render import Render
from .final_error import TOLERANCE
from .final_image import FinalImage, has_wide_filter

#: Errors with a limit (parameters of an integrator, and measured values of a render) -> their names in the verdict.
ERRORS = {"noise": "error", "noise_99": "error of 99 % of the pixels", "noise_999": "error of 99.9 %"}


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


def verdict(render: Any, final: FinalImage | None = None, interrupted: bool = False) -> str:
    """Returns the errors of the displayed image (white = 1) that a ``render`` has reached, and what ended it, in words.

    ``final`` is the final image of a render with a denoiser. The bound in brackets after an error holds in about 95 of
    100 renders.
    """
    ended = end_cause(render, interrupted)
    parts = _errors(render, ended) if isinstance(render, Render) else []
    if final is not None:
        parts.append(denoised_words(final, interrupted))
    elif not parts:
        bound = render.noise_bound() if isinstance(render, Render) else float("nan")
        words = "unknown" if isnan(bound) else f"at most about {bound:.2g}"
        parts = [f"error {words} (only a limit of the noise measures it)"]
    if ended == "samples":
        parts.append(f"ended by the maximum number of samples per pixel, {most_samples(render)}")
    return ", ".join(parts)


def _errors(render: Render, ended: str | None) -> list[str]:
    """Returns the measured errors that have a limit, in words."""
    reached, parts = render.reached, list[str]()
    # After an interruption or a time limit, the error was measured at an earlier image; the error is now lower.
    below = "" if ended in ("noise", "samples") else "below "
    for name, limit in limits(render).items():
        measured = getattr(reached, name)
        parts.append(f"{ERRORS[name]} {'not known yet,' if isnan(measured) else f'{below}{measured:.2g}'} of {limit:g}")
        if name == "noise" and reached.uncertain:
            parts.append(f"uncertain: it may be {reached.noise_at_most:.2g}")
            if reached.tiny_lamp:
                parts[-1] += " or more, as glossy surfaces reflect a lamp smaller than a pixel"
        elif name == "noise" and not below:
            parts[-1] += f" (95 %: below {reached.noise_at_most:.3g})"
    return [f"reached the time limit at {parts[0]}", *parts[1:]] if parts and ended == "time" else parts


def denoised_words(final: FinalImage, interrupted: bool = False) -> str:
    """Returns the errors of a denoised image, or why the ``final`` image is not denoised, in words."""
    if interrupted and len(final.images) == 1:
        return "not denoised: interrupted"
    if why := final.why_raw:
        return f"not denoised: {why}"
    result = final.denoised()
    limit = final.render.target.limits[0] if isinstance(final.render, Render) else 0.0
    words = f"denoised: error about {result.noise:.2g}, raw {result.raw_noise:.2g}"
    if result.at_most > TOLERANCE * max(result.noise, limit):
        words += f", uncertain: its error may be {result.at_most:.2g}"
    if has_wide_filter(final.denoiser.sensor):
        words += " (the film's filter is wider than a pixel; a box filter suits a denoiser better)"
    return words
