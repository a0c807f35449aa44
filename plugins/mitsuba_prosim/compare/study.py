"""The comparison of two contestants: its runs, interleaved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from . import facts, measures, runs
from .runs import Contestant, Reference
from .scenes import Scene, Spec

#: Transport of light -> its name in progress reports.
LIGHT = {"paths": "all paths", "direct": "direct light", "scene": "the scene's light"}

#: Parameters that end a render by its sample counts, not by its noise.
UNTARGETED: dict[str, Any] = {"noise": 0.0, "time": 0.0}


@dataclass(frozen=True)
class Effort:
    """The amount of work."""

    #: Square roots of the sample counts of the curves.
    levels: tuple[int, ...] = (2, 3, 4, 6, 9)
    rounds: int = 5
    #: Time for the reference of each transport.
    seconds: float = 60
    #: Folder of references; None for the user's.
    cache: Path | None = None
    #: Whether each image is also denoised.
    denoise: bool = False
    #: Receives the current step and its progress, 0 to 1.
    tell: Callable[[str, float], None] = field(default=lambda text, done: None)


@dataclass
class Section:
    """The contestants of one transport of light: the rows of the table by role, and the curves by role and level.

    Roles are "a", "b", "b at equal samples" and "b at equal time" for rows, "a" and "b" for curves. A level is the
    square root of the sample count.
    """

    transport: str
    specs: dict[str, Spec]
    reference: Reference
    rows: dict[str, Contestant]
    curves: dict[str, dict[int, Contestant]]

    def contestants(self) -> list[Contestant]:
        """All contestants, rows first."""
        return [*self.rows.values(), *(point for curve in self.curves.values() for point in curve.values())]


def study(
    scene: Scene, name: str, a: Spec, b: Spec, effort: Effort = Effort(), exposure: float = 0.0
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Compares two contestants on a scene called ``name``, at ``exposure`` in stops.

    Returns ``(facts, images)``: a dictionary of text and numbers, fit for JSON, and arrays by name.
    """
    transport, scale = b.transport or a.transport or "scene", 2.0**exposure
    sections = [section_of(scene, {"a": a, "b": b}, transport, effort)]
    free = next((spec for spec in (a, b) if spec.transport is None), None)
    own = section_of(scene, {"a": free}, "scene", effort) if free and transport != "scene" else None
    sections += [own] if own else []
    references = {c: section.reference.image for section in sections for c in section.contestants()}
    scaled = {name: lambda image, truth, m=m: m(image * scale, truth * scale) for name, m in measures.ALL.items()}
    results = runs.interleaved(references, effort.rounds, scaled, lambda done: effort.tell("rendering in turn", done))
    height, width = sections[0].reference.image.shape[:2]
    result = {
        "scene": name,
        "a": a.text,
        "b": b.text,
        "rounds": effort.rounds,
        "exposure": exposure,
        "denoise": effort.denoise,
        "machine": runs.machine(),
        "width": int(width),
        "height": int(height),
        "sections": [facts.of_section(section, results, scale) for section in sections],
    }
    images: dict[str, np.ndarray] = {}
    for k, section in enumerate(sections):
        images |= {f"{k}/{name}": image for name, image in facts.pictures(section, results, scale).items()}
    if own and free:
        paths, alone = (section.reference.image * scale for section in sections)
        result["difference"], more = facts.difference(scene, free, paths, alone, scale)
        images |= more
    return result | {"scales": facts.scales(images)}, images


def section_of(scene: Scene, specs: dict[str, Spec], transport: str, effort: Effort) -> Section:
    """The contestants of one transport, with their reference; A alone where ``specs`` has no B."""
    reference = runs.reference(
        effort.cache or runs.cache_folder(),
        f"{scene.key} {transport} {[spec.text for spec in specs.values()]}",
        [converging(scene, spec, transport) for spec in specs.values()],
        effort.seconds,
        lambda done: effort.tell(f"reference of {LIGHT[transport]}", done),
    )
    a, b = specs["a"], specs.get("b")
    rows = {"a": scene.contestant(a, transport)}
    levels = dict.fromkeys(specs, effort.levels)
    if b and b.is_adaptive:
        rows["b"] = scene.contestant(b, transport)
    elif b:
        # B may need more samples for the error of A.
        levels["b"] = (*effort.levels, round(1.6 * effort.levels[-1]), round(2.5 * effort.levels[-1]))
        effort.tell("finding equal times", 0.0)
        rows["b at equal samples"], rows["b at equal time"] = equals(scene, rows["a"], b, transport)
    if effort.denoise:
        rows |= {f"{role} denoised": replace(row, denoised=True) for role, row in rows.items()}
    curves = {role: {n: at_level(scene, spec, transport, n) for n in levels[role]} for role, spec in specs.items()}
    return Section(transport, specs, reference, rows, curves)


def at_level(scene: Scene, spec: Spec, transport: str, n: int) -> Contestant:
    """The contestant with n * n samples per pixel, or at most as many if it is adaptive."""
    if not spec.is_adaptive:
        return scene.contestant(spec, transport, spp=n * n)
    own: Any = scene.contestant(spec, transport).integrator
    # With a fixed threshold all pixels would converge, and the curve would end.
    changes = {"samples": n, "threshold": own.threshold * own.samples / n} | UNTARGETED
    return scene.contestant(spec.but(**changes), transport)


def converging(scene: Scene, spec: Spec, transport: str) -> Contestant:
    """The contestant as an unbiased estimator of the reference, with 64 samples."""
    if spec.is_adaptive:
        return scene.contestant(spec.but(adaptive="none", samples=8, **UNTARGETED), transport)
    return scene.contestant(spec, transport, spp=64)


def equals(scene: Scene, a: Contestant, b: Spec, transport: str) -> tuple[Contestant, Contestant]:
    """Contestants of ``b`` with as many samples as ``a`` takes, and with as many as take the same time."""
    samples = max(round(float(np.mean(a.counts()))), 1)

    def processor_seconds(contestant: Contestant) -> float:
        contestant.render(0)  # compiles
        return float(np.median([contestant.render(0)[2] for _ in range(3)]))

    wanted = processor_seconds(a)
    spp, equal = samples, scene.contestant(b, transport, spp=samples)
    for _ in range(4):  # a render has costs that do not grow with the samples, so the first guess is not the last
        ratio = wanted / processor_seconds(equal)
        if 0.9 < ratio < 1.1:
            break
        spp = min(max(round(spp * ratio), 1), 4096)
        equal = scene.contestant(b, transport, spp=spp)
    return scene.contestant(b, transport, spp=samples), equal
