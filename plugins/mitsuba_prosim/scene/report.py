"""What a render that was asked for noise or for time has come to, in words."""

from __future__ import annotations

from math import isnan
from typing import TYPE_CHECKING

import mitsuba as mi

from ..engine.plan import UNLIMITED

if TYPE_CHECKING:
    from ..engine.render import Reached

#: An image is as long as was asked for from this part of the time on: its end is aimed at from below.
IN_TIME = 0.97


def sentence(
    integrator: mi.Integrator,
    reached: Reached | None,
    interrupted: bool,
    by: str = "a signal",
    at_most: float | None = None,
) -> str | None:
    """Noise, samples and seconds of a render of ``integrator`` that has ``reached`` this, and what ended it if that was
    not the noise; None where neither noise nor time was asked for. ``by``: what has ``interrupted`` it; ``at_most``:
    what the noise is at most, about, where nobody has measured it.
    """
    if reached is None or not asked(integrator):
        return None
    ended = end(integrator, reached, interrupted)
    parts = [f"{reached.samples:.1f} samples a pixel", f"{reached.seconds:.1f} s"]
    if integrator.time:
        parts[1] += f" of {integrator.time:g}"
    if at_most is not None:
        parts.insert(
            0, f"noise {'not known' if isnan(at_most) else f'at most about {at_most:.2g}'} (--noise measures it)"
        )
    # Where it was cut short, the image has got better since.
    below = "" if ended in ("noise", "samples") else "below "
    for word, measured, most in reversed(noises(integrator, reached)):
        parts.insert(0, f"{word} {'not known yet,' if isnan(measured) else f'{below}{measured:.2g}'} of {most:g}")
    if ended == "samples":
        parts.append(f"ended by the most samples that a pixel may have, {integrator.max_samples or UNLIMITED}")
    elif ended == "interrupted" or (ended == "time" and noises(integrator, reached)):
        parts.append("ended by " + (by if interrupted else "the time"))
    return ", ".join(parts)


def facts(integrator: mi.Integrator, reached: Reached | None, interrupted: bool) -> dict[str, str]:
    """The same as metadata: ``prosim.samples``, the mean of a pixel; ``prosim.noise``, ``prosim.noise_99`` and
    ``prosim.noise_999``, if they were measured; and ``prosim.ended``, by what, where noise or time was asked for.
    """
    result = {}
    if reached is not None:
        result["prosim.samples"] = f"{reached.samples:.6g}"
        for name in ("noise", "noise_99", "noise_999"):
            if not isnan(measured := getattr(reached, name)):
                result[f"prosim.{name}"] = f"{measured:.6g}"
        if asked(integrator):
            result["prosim.ended"] = end(integrator, reached, interrupted)
    return result


def nothing(reached: Reached | None) -> bool:
    """Whether a render is known to have ended before the first sample."""
    return reached is not None and reached.samples == 0


def interrupted(reached: Reached | None) -> str:
    """What a signal has left of a render, in words."""
    return "interrupted" if reached is None or reached.least > 0 else "interrupted: pixels without a sample are black"


def asked(integrator: mi.Integrator) -> bool:
    """Whether an integrator was asked for noise or time."""
    return any(getattr(integrator, name, 0) for name in ("noise", "noise_99", "noise_999", "time"))


def noises(integrator: mi.Integrator, reached: Reached) -> list[tuple[str, float, float]]:
    """What was asked for of the noise: ``(what in words, measured, asked)``."""
    asked = [
        ("noise", reached.noise, integrator.noise),
        ("that of 99 pixels in 100", reached.noise_99, integrator.noise_99),
        ("that of 999 in 1000", reached.noise_999, integrator.noise_999),
    ]
    return [one for one in asked if one[2]]


def end(integrator: mi.Integrator, reached: Reached, interrupted: bool) -> str:
    """What ended a render: ``interrupted``, ``noise``, ``time``, or ``samples`` (each pixel has all that it may
    have).
    """
    if interrupted:
        return "interrupted"
    noise = noises(integrator, reached)
    if noise and all(measured <= most for _, measured, most in noise):
        return "noise"
    if integrator.time and reached.seconds >= IN_TIME * integrator.time:
        return "time"
    return "samples"
