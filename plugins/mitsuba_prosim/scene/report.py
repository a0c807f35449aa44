"""The result of a render with a goal for noise or time, in words and as metadata."""

from __future__ import annotations

from math import isnan
from typing import TYPE_CHECKING

import mitsuba as mi

from ..engine.plan import UNLIMITED

if TYPE_CHECKING:
    from ..engine.render import Reached

#: A render has used its time from this part of it on, as it aims to end before.
IN_TIME = 0.97

#: Goal of an integrator, and measured value of a render -> the same in words.
NOISES = {"noise": "noise", "noise_99": "that of 99 pixels in 100", "noise_999": "that of 999 in 1000"}


def sentence(
    integrator: mi.Integrator,
    reached: Reached | None,
    interrupted: bool,
    by: str = "a signal",
    at_most: float | None = None,
) -> str | None:
    """Noise, samples and seconds of a render, and its end if that was not the noise; None without a goal.

    ``by``: the cause of an interruption; ``at_most``: an estimate of the noise where it was not measured.
    """
    if reached is None or not has_goal(integrator):
        return None
    ended, parts = end(integrator, reached, interrupted), []
    # The last measurement is older than the image of an interrupted render.
    below = "" if ended in ("noise", "samples") else "below "
    for name in goals(integrator):
        measured = getattr(reached, name)
        value = "not known yet," if isnan(measured) else f"{below}{measured:.2g}"
        parts.append(f"{NOISES[name]} {value} of {getattr(integrator, name):g}")
    if at_most is not None:
        value = "not known" if isnan(at_most) else f"at most about {at_most:.2g}"
        parts.append(f"noise {value} (--noise measures it)")
    limit = f" of {integrator.time:g}" if integrator.time else ""
    parts += [f"{reached.samples:.1f} samples a pixel", f"{reached.seconds:.1f} s{limit}"]
    if ended == "samples":
        parts.append(f"ended by the maximum number of samples per pixel, {integrator.max_samples or UNLIMITED}")
    elif ended == "interrupted" or (ended == "time" and goals(integrator)):
        parts.append("ended by " + (by if interrupted else "the time"))
    return ", ".join(parts)


def facts(integrator: mi.Integrator, reached: Reached | None, interrupted: bool) -> dict[str, str]:
    """Metadata of an image: ``prosim.samples``, the mean of a pixel; ``prosim.noise``, ``prosim.noise_99`` and
    ``prosim.noise_999``, if they were measured; and with a goal ``prosim.ended``, see :func:`end`.
    """
    if reached is None:
        return {}
    values = {"samples": reached.samples} | {name: getattr(reached, name) for name in NOISES}
    result = {f"prosim.{name}": f"{value:.6g}" for name, value in values.items() if not isnan(value)}
    if has_goal(integrator):
        result["prosim.ended"] = end(integrator, reached, interrupted)
    return result


def goals(integrator: mi.Integrator) -> list[str]:
    """The parameters among :data:`NOISES` that an integrator has."""
    return [name for name in NOISES if getattr(integrator, name, 0)]


def has_goal(integrator: mi.Integrator) -> bool:
    """Whether an integrator has a goal for noise or time."""
    return bool(goals(integrator) or getattr(integrator, "time", 0))


def end(integrator: mi.Integrator, reached: Reached, interrupted: bool) -> str:
    """The cause of a render's end: ``interrupted``, ``noise``, ``time``, or ``samples`` (the maximum number)."""
    if interrupted:
        return "interrupted"
    noises = goals(integrator)
    if noises and all(getattr(reached, name) <= getattr(integrator, name) for name in noises):
        return "noise"
    if integrator.time and reached.seconds >= IN_TIME * integrator.time:
        return "time"
    return "samples"
