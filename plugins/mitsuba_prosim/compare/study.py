"""The comparison itself: which runs, by turns."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from . import facts, measures, runs
from .scenes import Scene, Spec

#: What the transports of light are called where it is told what is going on.
LIGHT = {"paths": "all paths", "direct": "direct light", "scene": "the scene's light"}


@dataclass(frozen=True)
class Effort:
    """How much is rendered: square roots of the sample counts of the curves, rounds by turns, seconds for the reference
    of each transport, the folder that references are kept in (None: the user's), whether what is compared is denoised
    as well, and whom to tell what is going on and the part of it that is done.
    """

    levels: tuple[int, ...] = (2, 3, 4, 6, 9)
    rounds: int = 5
    seconds: float = 60
    cache: Path | None = None
    denoise: bool = False
    tell: Callable[[str, float], None] = field(default=lambda text, done: None)


def study(
    scene: Scene, name: str, a: Spec, b: Spec, effort: Effort = Effort(), exposure: float = 0.0
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Compares two contestants on a scene called ``name``.

    ``exposure``: in stops, for everything that is measured and shown. Returns ``(facts, images)``: a dictionary of text
    and numbers, fit for JSON, and arrays by name.
    """
    transport = b.transport or a.transport or "scene"
    free = [spec for spec in (a, b) if spec.transport is None]
    own_light = transport != "scene" and bool(free)

    parts = [contest(scene, a, b, transport, effort)]
    if own_light:
        parts.append(contest(scene, free[0], None, "scene", effort))
    everyone: list[runs.Contestant] = []
    for part in parts:
        part.each(everyone.append)
    for contestant in everyone:
        contestant.scale = 2.0**exposure
    results = iter(
        runs.by_turns(everyone, effort.rounds, measures.ALL, lambda done: effort.tell("rendering by turns", done))
    )
    parts = [part.each(lambda _: next(results)) for part in parts]
    scale = 2.0**exposure

    height, width = parts[0].reference.image.shape[:2]
    said = {
        "scene": name,
        "a": a.text,
        "b": b.text,
        "rounds": effort.rounds,
        "exposure": exposure,
        "denoise": effort.denoise,
        "machine": runs.machine(),
        "width": int(width),
        "height": int(height),
        "sections": [facts.section(part, a if k == 0 else free[0], b, k, scale) for k, part in enumerate(parts)],
    }
    images: dict[str, np.ndarray] = {}
    for k, part in enumerate(parts):
        images |= {f"{k}/{name}": image for name, image in facts.pictures(part, scale).items()}
    if own_light:
        paths, own = (part.reference.image * scale for part in parts)
        said["difference"], difference_images = facts.difference(scene, free[0], paths, own, scale)
        images |= difference_images
    return said | {"scales": facts.scales(images)}, images


def contest(scene: Scene, a: Spec, b: Spec | None, transport: str, effort: Effort) -> runs.Part:
    """The contestants of one transport, with their reference; without ``b``, ``a`` alone."""
    specs = {"a": a} | ({"b": b} if b else {})
    reference = runs.reference(
        effort.cache or runs.cache_folder(),
        f"{scene.key} {transport} {[s and s.text for s in (a, b)]}",
        [converging(scene, spec, transport) for spec in specs.values()],
        effort.seconds,
        lambda done: effort.tell(f"reference of {LIGHT[transport]}", done),
    )
    rows = {"a": scene.contestant(a, transport)}
    levels = {"a": effort.levels, "b": effort.levels}
    if b and b.counts_itself:
        rows["b"] = scene.contestant(b, transport)
    elif b:
        # Further, if need be, than A: it is asked what B takes for A's error.
        levels["b"] = (*effort.levels, round(1.6 * effort.levels[-1]), round(2.5 * effort.levels[-1]))
        effort.tell("finding equal times", 0.0)
        rows["b at equal samples"], rows["b at equal time"] = equals(scene, rows["a"], b, transport)
    if effort.denoise:
        rows |= {f"{role} denoised": replace(row, denoised=True) for role, row in rows.items()}
    part = runs.Part(
        transport,
        reference,
        rows,
        {role: {n: at_level(scene, spec, transport, n) for n in levels[role]} for role, spec in specs.items()},
    )

    def measured(contestant: runs.Contestant) -> runs.Contestant:
        contestant.reference = reference
        return contestant

    return part.each(measured)


#: What makes an integrator end by its samples, not by what they have come to.
UNTARGETED: dict[str, Any] = {"noise": 0.0, "time": 0.0}


def at_level(scene: Scene, spec: Spec, transport: str, n: int) -> runs.Contestant:
    """The contestant with n * n samples a pixel, or at most as many if it counts by itself."""
    if not spec.counts_itself:
        return scene.contestant(spec, transport, spp=n * n)
    own: Any = scene.contestant(spec, transport).integrator
    # The threshold goes with the count, or the curve would end where every pixel is quiet enough; so would it by noise.
    but = {"samples": n, "threshold": own.threshold * own.samples / n} | UNTARGETED
    return scene.contestant(spec.but(**but), transport)


def converging(scene: Scene, spec: Spec, transport: str) -> runs.Contestant:
    """The contestant as an estimator of the reference: without bias, 64 samples a pass."""
    if spec.counts_itself:
        return scene.contestant(spec.but(adaptive="none", samples=8, **UNTARGETED), transport)
    return scene.contestant(spec, transport, spp=64)


def equals(scene: Scene, a: runs.Contestant, b: Spec, transport: str) -> tuple[runs.Contestant, runs.Contestant]:
    """Contestants ``b`` with as many samples as ``a`` really takes, and with as many as take the same time."""
    samples = max(round(float(np.mean(a.counts()))), 1)

    def processor_seconds(contestant: runs.Contestant) -> float:
        contestant.render(0)  # compiles
        return float(np.median([contestant.render(0)[1][1] for _ in range(3)]))

    wanted = processor_seconds(a)
    spp, equal = samples, scene.contestant(b, transport, spp=samples)
    for _ in range(4):  # a render has costs that do not grow with the samples, so the first guess is not the last
        ratio = wanted / processor_seconds(equal)
        if 0.9 < ratio < 1.1:
            break
        spp = min(max(round(spp * ratio), 1), 4096)
        equal = scene.contestant(b, transport, spp=spp)
    return scene.contestant(b, transport, spp=samples), equal
