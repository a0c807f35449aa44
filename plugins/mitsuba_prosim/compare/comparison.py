"""Compares two methods (integrators with samplers): renders a converged reference image, and measures the time and the
error of both in interleaved runs. The results are numbers and images for an HTML page.
"""

import os
import platform
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import numpy as np

from ..engine import environment
from ..engine.plan import TARGETS
from . import measures
from .methods import ComparedScene, Method, Spec

#: The first seed of references. Measured images have smaller seeds, and so other samples.
REFERENCE_SEEDS = 1 << 20


@dataclass
class Runs:
    """The runs of one method.

    ``values`` are the results of all rounds: "seconds" (elapsed), "cpu" (processor time) and the error measures against
    ``reference`` -> list. ``image`` is the latest image, multiplied by ``scale`` (the exposure), and ``counts`` its
    number of samples per pixel.
    """

    method: Method
    reference: np.ndarray
    scale: float = 1.0
    values: dict[str, list[float]] = field(default_factory=dict)
    image: np.ndarray = field(default_factory=lambda: np.zeros(0))
    counts: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def measure(self, number: int) -> None:
        """Renders an image with the seed ``number``, the round, and stores its time and errors; round 0 only compiles
        the kernels.
        """
        image, self.counts, seconds, cpu = self.method.render(number)
        self.image = image * self.scale
        if number > 0:
            errors = {name: measure(self.image, self.reference) for name, measure in measures.ALL.items()}
            for name, value in {"seconds": seconds, "cpu": cpu, **errors}.items():
                self.values.setdefault(name, []).append(value)

    def facts(self) -> dict[str, Any]:
        """Returns the mean number of samples per pixel, and the median, the minimum and the maximum of each of
        ``values``.
        """
        return {"samples": float(np.mean(self.counts))} | {
            name: {"median": float(np.median(values)), "least": min(values), "most": max(values)}
            for name, values in self.values.items()
        }


def interleaved(runs: Sequence[Runs], rounds: int) -> Iterator[float]:
    """Measures each of ``runs`` in each round, after one for warming up; yields the progress, 0 to 1.

    The methods render in turn, so that other load of the machine affects all of them equally.
    """
    for number in range(rounds + 1):
        for k, run in enumerate(runs):
            run.measure(number)
            yield (number * len(runs) + k + 1) / ((rounds + 1) * len(runs))


class Reference:
    """A converged reference image: the mean of many images by each of the ``estimators``, methods with the same
    expected value, weighted by the inverse of its variance.
    """

    def __init__(self, estimators: Sequence[Method]) -> None:
        self._estimators = estimators
        #: Elapsed time, and number of images of each estimator.
        self.seconds, self.passes = 0.0, 0

    def converge(self, seconds: float) -> Iterator[float]:
        """Renders images with each estimator in turn for ``seconds`` seconds, at least three, and computes the
        reference image and its error; yields the progress, 0 to 1.
        """
        sums, squares, begin = np.zeros(1), np.zeros(1), time.perf_counter()
        while self.passes < 3 or self.seconds < seconds:
            first = REFERENCE_SEEDS + len(self._estimators) * self.passes  # methods may be equal, but not their samples
            images = [method.render(first + k)[0] for k, method in enumerate(self._estimators)]
            sums = sums + np.array(images, dtype=np.float64)
            squares = squares + np.square(images, dtype=np.float64)
            self.passes += 1
            self.seconds = time.perf_counter() - begin
            yield min(self.seconds / seconds, 1.0) if seconds else 1.0
        mean = sums / self.passes
        variance = (np.maximum(squares / self.passes - mean**2, 0) / (self.passes - 1)).mean(axis=(1, 2, 3))
        weights = 1 / np.maximum(variance, 1e-60)  # the variance of an image without noise is 0
        weights /= weights.sum()
        self.image = np.tensordot(weights, mean, 1)
        #: The standard error of a channel, as the root mean square over pixels and channels.
        self.error = float(np.sqrt(np.sum(weights**2 * variance)))
        #: RMS difference of the mean images of the two estimators, divided by its expected value from noise; 1 means
        #: that they agree. None without noise.
        self.disagreement: float | None = None
        if len(mean) > 1 and variance.all():
            self.disagreement = float(np.sqrt(np.mean((mean[0] - mean[1]) ** 2) / variance.sum()))


def machine() -> dict[str, str | int | float | None]:
    """Returns the software, the processor, the number of cores and the load of this machine."""
    return environment.this_environment() | {
        "cores": os.cpu_count(),
        "threads": dr.thread_count(),
        "python": platform.python_version(),
        "load": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
    }


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
        for progress in interleaved([*rows.values()], facts["rounds"]):
            yield "rendering in turn", progress
        facts["rows"] = [{"role": role, "name": run.method.name} | run.facts() for role, run in rows.items()]
        facts["reference"] = {name: getattr(reference, name) for name in ("seconds", "passes", "disagreement")}
        facts["reference"] |= {"error": reference.error * scale, "mean": float(np.mean(true))}
        facts |= {"machine": machine(), "height": len(true), "width": len(true[0])}
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
