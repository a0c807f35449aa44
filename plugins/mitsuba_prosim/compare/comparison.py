"""Compares two methods (integrators with samplers) in interleaved runs; the results are numbers and images for an HTML
page.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from . import measures, runs
from .methods import ComparedScene, Method, Spec
from .runs import Reference, Runs

#: Light transport, that is, the simulated light paths -> its name on the page.
LIGHT = {"paths": "all paths", "direct": "direct light", "scene": "the scene's light"}

#: Parameters that switch off the error target and the time limit, so that the sample counts end a render.
UNTARGETED: dict[str, Any] = {"noise": 0.0, "time": 0.0}

#: Kind of a map (the last part of its name) -> its colour map. All maps of one kind have the same scale.
COLOUR_MAPS = {"error": "magma", "flip": "magma", "counts": "viridis"}


@dataclass(frozen=True)
class Effort:
    """How much work a comparison does.

    ``sqrt_spp`` are the square roots of the samples per pixel of the error curves, ``rounds`` the number of measured
    renders of each method, and ``seconds`` the time for each reference. ``denoise``: denoised images are compared, too.
    """

    sqrt_spp: tuple[int, ...]
    rounds: int
    seconds: float
    denoise: bool


class Comparison:
    """Compares the methods ``a`` and ``b`` on a scene called ``name``. ``exposure`` is in stops."""

    def __init__(self, scene: ComparedScene, name: str, a: Spec, b: Spec, effort: Effort, exposure: float) -> None:
        self.scene, self.a, self.b, self.effort, self.scale = scene, a, b, effort, 2.0**exposure
        #: Results that can be written as JSON, and images by name; both are complete after :meth:`run`.
        self.facts: dict[str, Any] = {
            "scene": name,
            "a": a.text,
            "b": b.text,
            "rounds": effort.rounds,
            "exposure": exposure,
            "denoise": effort.denoise,
        }
        self.images: dict[str, np.ndarray] = {}

    def run(self) -> Iterator[tuple[str, float]]:
        """Renders all images, and stores the results in :attr:`facts` and :attr:`images`; yields the name of the
        current phase, and its progress, 0 to 1.

        The first section of the results compares the methods on light paths that both simulate. If only one of them is
        ``prosim``, a second section measures it on the light paths that the scene file selects.
        """
        a, b = self.a, self.b
        transport = b.transport or a.transport or "scene"
        any_transport = next((spec for spec in (a, b) if spec.transport is None), None)
        sections = [Section(self.scene, transport, {"a": a, "b": b}, self.effort, self.scale)]
        if any_transport and transport != "scene":
            sections.append(Section(self.scene, "scene", {"a": any_transport}, self.effort, self.scale))
        for section in sections:
            yield from section.prepare()
        for progress in runs.interleaved([run for section in sections for run in section.runs()], self.effort.rounds):
            yield "rendering in turn", progress
        height, width = map(int, sections[0].image.shape[:2])
        self.facts |= {"machine": runs.machine(), "width": width, "height": height}
        self.facts["sections"] = [section.facts() for section in sections]
        for k, section in enumerate(sections):
            self.images |= {f"{k}/{name}": image for name, image in section.images().items()}
        self.facts["scales"] = scales(self.images)


class Section:
    """One section of a comparison, which measures the methods on the light paths ``transport`` (see :data:`LIGHT`).

    ``specs`` has the method "a" and perhaps "b". ``rows`` maps the role of a row of the table ("a", "b", "b at equal
    samples", "b at equal time", perhaps followed by "denoised") to its runs; ``curves`` maps "a" and "b" to the runs of
    the error curve, by the square root of the samples per pixel. All images are multiplied by ``scale``, the exposure.
    """

    def __init__(
        self, scene: ComparedScene, transport: str, specs: dict[str, Spec], effort: Effort, scale: float
    ) -> None:
        self.scene, self.transport, self.specs, self.effort, self.scale = scene, transport, specs, effort, scale
        self.reference = Reference([reference_estimator(scene, spec, transport) for spec in specs.values()])

    def prepare(self) -> Iterator[tuple[str, float]]:
        """Renders the reference image, and prepares the runs; yields the name of the current phase, and its progress, 0
        to 1.
        """
        scene, transport, effort = self.scene, self.transport, self.effort
        for progress in self.reference.converge(effort.seconds):
            yield f"reference of {LIGHT[transport]}", progress
        self.image = self.reference.image * self.scale
        b = self.specs.get("b")
        rows = {"a": scene.method(self.specs["a"], transport)}
        sqrt_spp = dict.fromkeys(self.specs, effort.sqrt_spp)
        if b and b.is_adaptive:
            rows["b"] = scene.method(b, transport)
        elif b:
            # B may need more samples than A for the same error.
            sqrt_spp["b"] = (*effort.sqrt_spp, round(1.6 * effort.sqrt_spp[-1]), round(2.5 * effort.sqrt_spp[-1]))
            yield "finding equal times", 0.0
            rows["b at equal samples"], rows["b at equal time"] = equal_cost_methods(scene, rows["a"], b, transport)
        if effort.denoise:
            rows |= {f"{role} denoised": replace(row, denoised=True) for role, row in rows.items()}
        self.rows = {role: Runs(row, self.image, self.scale) for role, row in rows.items()}
        self.curves = {
            role: {n: Runs(at_level(scene, spec, transport, n), self.image, self.scale) for n in sqrt_spp[role]}
            for role, spec in self.specs.items()
        }

    def runs(self) -> list[Runs]:
        """Returns all runs of this section: those of the rows, and then those of the error curves."""
        return [*self.rows.values(), *(point for curve in self.curves.values() for point in curve.values())]

    def facts(self) -> dict[str, Any]:
        """Returns the results of this section, as JSON has them: rows, curves with their log-log slopes, and the
        reference. With two curves, ``equal_error`` is the cost of b at the error of a, see :func:`equal_error`.
        """
        rows = [{"role": role, "name": run.method.name} | run.facts() for role, run in self.rows.items()]
        curves: list[dict[str, Any]] = []
        for role, curve in self.curves.items():
            points = [{"level": level} | run.facts() for level, run in curve.items()]
            errors = [median(point, "rmse") for point in points]
            slopes = {c: measures.slope([median(point, c) for point in points], errors) for c in ("samples", "cpu")}
            curves.append({"role": role, "name": self.specs[role].text, "points": points, "slopes": slopes})
        reference = {name: getattr(self.reference, name) for name in ("seconds", "passes", "disagreement")}
        reference["error"] = self.reference.error * self.scale
        mean = float(np.mean(self.reference.image) * self.scale)
        result = {"transport": self.transport, "mean": mean, "rows": rows, "curves": curves, "reference": reference}
        if len(curves) == 2:
            result["equal_error"] = {
                measure: {cost: equal_error(curves[1]["points"], cost, measure, rows[0]) for cost in ("samples", "cpu")}
                for measure in ("rmse", "flip")
            }
        return result

    def images(self) -> dict[str, np.ndarray]:
        """Returns the reference, and the image, the error maps and the sample counts of each row: name -> array."""
        images = {"reference": self.image}
        for role, run in self.rows.items():
            images |= {
                f"{role}/image": run.image,
                f"{role}/error": measures.tone_mapped_error(run.image, self.image),
                f"{role}/flip": measures.flip_map(run.image, self.image),
                f"{role}/counts": run.counts,
            }
        return images


def median(facts: Mapping[str, Any], name: str) -> float:
    """Returns the median of the measure ``name`` from ``facts`` (see :meth:`.Runs.facts`), or the number of "samples"
    per pixel, at least 1e-7, so that its logarithm exists.
    """
    value = facts[name]
    return max(float(value if name == "samples" else value["median"]), 1e-7)


def at_level(scene: ComparedScene, spec: Spec, transport: str, n: int) -> Method:
    """Returns the method of ``spec`` with ``n``² samples per pixel. For ``prosim``, ``n`` becomes the parameter
    ``samples``, the threshold is proportional to 1/``n``, and there are no targets.
    """
    if not spec.is_adaptive:
        return scene.method(spec, transport, spp=n * n)
    integrator: Any = scene.method(spec, transport).integrator
    # With a fixed threshold, more samples would not reduce the error after all pixels have converged.
    changes = {"samples": n, "threshold": integrator.threshold * integrator.samples / n} | UNTARGETED
    return scene.method(spec.with_parameters(**changes), transport)


def reference_estimator(scene: ComparedScene, spec: Spec, transport: str) -> Method:
    """Returns the method of ``spec`` with 64 samples in every pixel; the mean of its images is the reference."""
    if spec.is_adaptive:
        return scene.method(spec.with_parameters(adaptive="none", samples=8, **UNTARGETED), transport)
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


def equal_error(points: list[dict[str, Any]], cost: str, measure: str, row: dict[str, Any]) -> dict[str, Any]:
    """Returns the cost ("samples" or "cpu") at which the error curve ``points`` has the error of ``row`` by
    ``measure``, divided by the cost of ``row``; and whether the curve reaches this error.

    Otherwise the highest cost of the curve is used; or that of its cheapest point if already this one has a smaller
    error.
    """
    costs = [median(point, cost) for point in points]
    *errors, error = (median(facts, measure) for facts in (*points, row))
    cheapest = int(np.argmin(costs))
    needed = costs[cheapest] if error > errors[cheapest] else measures.cost_at(error, costs, errors)
    return {"ratio": (max(costs) if needed is None else needed) / median(row, cost), "reached": needed is not None}


def scales(images: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Returns the value at the upper end of the colour scale that all maps of a kind share: the maximum of sample
    counts, and the 99.5th percentile of errors, so that a few pixels do not make the rest dark; 1 if all values are 0.
    """
    result = {}
    for kind in COLOUR_MAPS:
        maps = [image for name, image in images.items() if name.endswith("/" + kind)]
        result[kind] = float(max((m.max() if kind == "counts" else np.percentile(m, 99.5)) for m in maps)) or 1.0
    return result
