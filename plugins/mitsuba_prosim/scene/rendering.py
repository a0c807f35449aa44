"""Rendering into the film, and being told how far it is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi

from ..engine.part import Part
from ..engine.record import Record


def tells_progress(integrator: mi.Integrator) -> bool:
    """Whether an integrator says how far it is, as ours does: others hold the interpreter until they are done."""
    return hasattr(integrator, "progress")


def keeps(integrator: mi.Integrator) -> bool:
    """Whether an integrator can go on with an image, as ours does in all but scalar variants."""
    return hasattr(integrator, "keep") and dr.is_jit_v(mi.Float)


def samples_of_a_step() -> int:
    """How many samples take a second or so in a scene of the usual kind."""
    return 2**20 * dr.thread_count() if dr.backend_v(mi.Float) == dr.JitBackend.LLVM else 2**24


def render(
    scene: mi.Scene,
    sensor: mi.Sensor,
    seed: int = 0,
    spp: int = 0,
    tell: Callable[[float], None] | None = None,
    begin: Record | None = None,
    keep: Callable[[Callable[[], Record], bool], None] | None = None,
    part: Part | None = None,
    integrator: Any = None,
) -> float | None:
    """Renders into the sensor's film with the scene's integrator, or another, and waits for the end.

    ``spp``: samples per pixel, 0 for as many as the scene says; ``tell``: called with the part done, 0 to 1, at every
    step of an integrator that :func:`tells_progress`. ``begin``, ``keep``: for an integrator that :func:`keeps`, the
    record of an image to go on with, and what is called with a record from time to time; ``part``: of the image, where
    that is to be kept.

    Returns what the noise is at most, about, where time was asked for and no noise, as nobody has measured it then;
    not a number where that is not known, and None where it was not asked for.
    """
    integrator = integrator or scene.integrator()
    told = tell is not None and tells_progress(integrator)
    if told and integrator.taker is None:
        # At each step Ctrl-C is heard as well.
        integrator.band = min(integrator.band, max(2**10, samples_of_a_step() // (spp or int(integrator.samples) ** 2)))
    if told:
        integrator.progress = tell
    snapshot = None
    unmeasured = keeps(integrator) and integrator.time and not (integrator.noise or integrator.noise_99)
    try:
        if begin is not None or keep is not None or unmeasured:
            integrator.keep = keep
            for wave in integrator.waves(scene, sensor, seed, spp, begin, part):
                snapshot = wave
        else:
            # Mitsuba's own integrators in Python insist on developing the film, so all do; writing it is another step.
            integrator.render(scene, sensor, seed=seed, spp=spp, develop=True, evaluate=True)
        dr.sync_thread()
        return snapshot.noise_at_most() if snapshot is not None and unmeasured else None
    finally:
        if told:
            integrator.progress = integrator.keep = None
