"""What a render that was asked for noise or for time has come to, in words."""

from __future__ import annotations

from math import isnan

import mitsuba as mi

from ..rendering.plan import UNLIMITED

#: An image is as long as was asked for from this part of the time on: its end is aimed at from below.
IN_TIME = 0.97


def sentence(integrator: mi.Integrator, interrupted: bool) -> str | None:
    """Noise, samples and seconds of the last render of ``integrator``, and what ended it if that was not the noise;
    None where neither noise nor time was asked for.
    """
    if not asked(integrator):
        return None
    reached, ended = integrator.reached, end(integrator, interrupted)
    parts = [f"{reached.samples:.1f} samples a pixel", f"{reached.seconds:.1f} s"]
    if integrator.time:
        parts[1] += f" of {integrator.time:g}"
    if not isnan(reached.noise):
        # Where it was cut short, the image has got better since.
        below = "" if ended in ("noise", "samples") else "below "
        parts.insert(0, f"noise {below}{reached.noise:.2g} of {integrator.noise:g}")
    elif integrator.noise:
        parts.insert(0, f"noise not known yet, of {integrator.noise:g}")
    if ended == "samples":
        parts.append(f"ended by the most samples that a pixel may have, {integrator.max_samples or UNLIMITED}")
    elif ended == "interrupted" or (ended == "time" and integrator.noise):
        parts.append("ended by " + ("a signal" if interrupted else "the time"))
    return ", ".join(parts)


def facts(integrator: mi.Integrator, interrupted: bool) -> dict[str, str]:
    """The same as metadata: ``prosim.samples``, the mean of a pixel; ``prosim.noise``, if it was measured; and
    ``prosim.ended``, by what, where noise or time was asked for.
    """
    result = {}
    if reached := getattr(integrator, "reached", None):
        result["prosim.samples"] = f"{reached.samples:.6g}"
        if not isnan(reached.noise):
            result["prosim.noise"] = f"{reached.noise:.6g}"
        if asked(integrator):
            result["prosim.ended"] = end(integrator, interrupted)
    return result


def nothing(integrator: mi.Integrator) -> bool:
    """Whether the last render of ``integrator`` is known to have ended before the first sample."""
    last = getattr(integrator, "reached", None)
    return last is not None and last.samples == 0


def asked(integrator: mi.Integrator) -> bool:
    """Whether an integrator has rendered, and was asked for noise or time."""
    return getattr(integrator, "reached", None) is not None and (integrator.noise > 0 or integrator.time > 0)


def end(integrator: mi.Integrator, interrupted: bool) -> str:
    """What ended the last render: ``interrupted``, ``noise``, ``time``, or ``samples`` (each pixel has all that it may
    have).
    """
    if interrupted:
        return "interrupted"
    if integrator.reached.noise <= integrator.noise:
        return "noise"
    if integrator.time and integrator.reached.seconds >= IN_TIME * integrator.time:
        return "time"
    return "samples"
