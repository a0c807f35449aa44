"""Compares two methods (integrators with samplers) in interleaved runs; the results are numbers and images for an HTML
page.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..engine.plan import TARGETS
from . import measures, runs
from .methods import ComparedScene, Method, Spec
from .runs import Reference, Runs

#: Light transport, that is, the simulated light paths -> its name on the page.
LIGHT = {"paths": "all paths", "direct": "direct light", "scene": "the scene's light"}

#: Parameters with which ``prosim`` takes 64 samples in each pixel.
UNIFORM: dict[str, Any] = {"adaptive": "none", "samples": 8, **dict.fromkeys(TARGETS, 0.0)}


class Comparison:
    """Compares the methods ``a`` and ``b`` on a scene called ``name``, in ``rounds`` measured renders of each.

    The reference takes at least ``seconds``. All images are multiplied by 2^``exposure``. If one of the methods is
    ``prosim``, it simulates the light paths of the other; if both are, those that the scene selects. Raises ValueError
    for a wrong specification.
    """

    def __init__(
        self, scene: ComparedScene, name: str, a: Spec, b: Spec, rounds: int, seconds: float, exposure: float
    ) -> None:
        self.scene, self.b, self.seconds = scene, b, seconds
        transport = b.transport or a.transport or "scene"
        self.reference = Reference([reference_estimator(scene, spec, transport) for spec in (a, b)])
        self.methods = {"a": scene.method(a, transport)}
        if b.is_adaptive:
            self.methods["b"] = scene.method(b, transport)
        #: Results that can be written as JSON, and images by name; both are complete after :meth:`run`.
        self.facts: dict[str, Any] = {
            "scene": name,
            "a": a.text,
            "b": b.text,
            "rounds": rounds,
            "exposure": exposure,
            "transport": transport,
        }
        self.images: dict[str, np.ndarray] = {}

    def run(self) -> Iterator[tuple[str, float]]:
        """Renders all images, and stores the results in :attr:`facts` and :attr:`images`; yields the name of the
        current phase, and its progress, 0 to 1.

        A row of the results has a role: "a", "b", "b at equal samples" or "b at equal time". Its images are those
        names followed by "/image", "/flip" and "/counts".
        """
        methods, reference, facts, scale = self.methods, self.reference, self.facts, 2.0 ** self.facts["exposure"]
        transport = facts["transport"]
        for progress in reference.converge(self.seconds):
            yield f"reference of {LIGHT[transport]}", progress
        if "b" not in methods:
            yield "finding equal times", 0.0
            equal = equal_cost_methods(self.scene, methods["a"], self.b, transport)
            methods |= zip(("b at equal samples", "b at equal time"), equal)
        true = reference.image * scale
        rows = {role: Runs(method, true, scale) for role, method in methods.items()}
        for progress in runs.interleaved([*rows.values()], facts["rounds"]):
            yield "rendering in turn", progress
        facts["rows"] = [{"role": role, "name": run.method.name} | run.facts() for role, run in rows.items()]
        facts["reference"] = {name: getattr(reference, name) for name in ("seconds", "passes", "disagreement")}
        facts["reference"] |= {"error": reference.error * scale, "mean": float(np.mean(true))}
        facts |= {"machine": runs.machine(), "height": len(true), "width": len(true[0])}
        self.images["reference"] = true
        for role, run in rows.items():
            flip = measures.flip_map(run.image, true)
            self.images |= {f"{role}/image": run.image, f"{role}/flip": flip, f"{role}/counts": run.counts}
        facts["scales"] = {kind: self._scale(kind) for kind in ("flip", "counts")}

    def _scale(self, kind: str) -> float:
        """Returns the value that is white in all maps of a kind: the maximum of sample counts, and the 99.5th
        percentile of differences, so that a few pixels do not make the rest dark; 1 if all values are 0.
        """
        maps = [image for name, image in self.images.items() if name.endswith("/" + kind)]
        return float(max(np.percentile(one, 100 if kind == "counts" else 99.5) for one in maps)) or 1.0


def reference_estimator(scene: ComparedScene, spec: Spec, transport: str) -> Method:
    """Returns the method of ``spec`` with 64 samples in every pixel; the mean of its images is the reference."""
    if spec.is_adaptive:
        return scene.method(spec.with_parameters(**UNIFORM), transport)
    return scene.method(spec, transport, spp=64)


def equal_cost_methods(scene: ComparedScene, a: Method, b: Spec, transport: str) -> tuple[Method, Method]:
    """Returns the method ``b``, which is not adaptive, with as many samples as ``a``, and with about the same rendering
    time, within about 10 % if one of the first four tried sample counts achieves this.
    """
    samples = max(round(float(np.mean(a.render(0)[1]))), 1)

    def processor_seconds(method: Method) -> float:
        method.render(0)  # compiles the kernels
        return float(np.median([method.render(0)[3] for _ in range(3)]))

    target_seconds = processor_seconds(a)
    spp, at_equal_time = samples, scene.method(b, transport, spp=samples)
    for _ in range(4):  # repeated, because a part of a render's time does not depend on the sample count
        ratio = target_seconds / processor_seconds(at_equal_time)
        if 0.9 < ratio < 1.1:
            break
        spp = min(max(round(spp * ratio), 1), 4096)
        at_equal_time = scene.method(b, transport, spp=spp)
    return scene.method(b, transport, spp=samples), at_equal_time
