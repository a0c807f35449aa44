"""Compares two methods (integrators with samplers): renders a converged reference image, and measures the time and the
error of both in interleaved runs, for an HTML page.
"""

import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ..engine.plan import TARGETS
from . import measures
from .methods import ComparedScene, Method, Spec

#: The first seed of references. Measured images have smaller seeds, and so other samples.
REFERENCE_SEEDS = 1 << 20


class Row:
    """A row of the results: the runs of one method, whose images are multiplied by ``scale``, the exposure.

    ``role`` is "a", "b", "b at equal samples" or "b at equal time".
    """

    def __init__(self, role: str, method: Method, reference: np.ndarray, scale: float) -> None:
        self.role, self.method, self.reference, self.scale = role, method, reference, scale
        #: "seconds" (elapsed), "cpu" (processor time), "samples", "rmse" and "flip" -> the values of all rounds.
        self.values = defaultdict[str, list[float]](list)
        #: The latest image, its error FLIP in each pixel, and its number of samples in each pixel.
        self.image = self.flip = self.counts = np.zeros(0)

    @property
    def name(self) -> str:
        """The method and the role, such as "path at equal time"."""
        return self.method.name + self.role[1:]

    def median(self, name: str) -> float:
        """Returns the median of some of the ``values``."""
        return float(np.median(self.values[name]))

    def measure(self, number: int) -> None:
        """Renders an image with the seed ``number``, the round, and stores its time and errors; round 0 only compiles
        the kernels.
        """
        image, self.counts, seconds, cpu = self.method.render(number)
        self.image = image * self.scale
        if number > 0:
            self.flip = measures.flip_map(self.image, self.reference)
            values = {"seconds": seconds, "cpu": cpu, "samples": float(self.counts.mean())}
            values |= {"rmse": measures.rmse(self.image, self.reference), "flip": float(self.flip.mean())}
            for name, value in values.items():
                self.values[name].append(value)


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


#: Light transport, that is, the simulated light paths -> its name on the page.
LIGHT = {"paths": "all paths", "direct": "direct light", "scene": "the scene's light"}

#: Parameters with which ``prosim`` takes 64 samples in each pixel.
UNIFORM: dict[str, Any] = {"adaptive": "none", "samples": 8, **dict.fromkeys(TARGETS, 0.0)}


class Comparison:
    """Compares the methods ``a`` and ``b`` on a scene, in ``rounds`` measured renders of each.

    The reference takes at least ``seconds``. All images are multiplied by 2^``exposure``. If one of the methods is
    ``prosim``, it simulates the light paths of the other; if both are, those that the scene selects. Raises ValueError
    for a wrong specification.
    """

    def __init__(self, scene: ComparedScene, a: Spec, b: Spec, rounds: int, seconds: float, exposure: float) -> None:
        self.scene, self.a, self.b, self.rounds, self.seconds = scene, a, b, rounds, seconds
        self.exposure, self.scale = exposure, 2.0**exposure
        self.transport = b.transport or a.transport or "scene"
        ours, other = (b, a) if b.is_adaptive else (a, b)
        depth = scene.settings_of(other).get("max_depth", -1)
        if ours.is_adaptive and self.transport == "paths" and isinstance(depth, int) and depth >= 0:
            if depth < 2:
                raise ValueError(f"{other.text!r}: max_depth {depth} allows no reflection, but prosim always has one")
            ours.parameters.setdefault("max_level", depth - 2)  # max_depth 2 allows one reflection, as level 0 does
        # Each takes 64 samples in every pixel.
        uniform = [
            scene.method(spec, self.transport, **UNIFORM) if spec.is_adaptive else self.at(64, spec) for spec in (a, b)
        ]
        self.reference = Reference(uniform)
        self.methods = {"a": scene.method(a, self.transport)}
        if b.is_adaptive:
            self.methods["b"] = scene.method(b, self.transport)
        #: The results of :meth:`run`.
        self.rows: list[Row] = []

    def at(self, spp: int, spec: Spec) -> Method:
        """Returns the method of ``spec``, which is not adaptive, with ``spp`` samples in each pixel."""
        return self.scene.method(spec, self.transport, spp)

    def run(self) -> Iterator[tuple[str, float]]:
        """Renders all images, and stores the results in :attr:`rows`; yields the name of the current phase, and its
        progress, 0 to 1.

        The methods render in turn, so that other load of the machine affects all of them equally.
        """
        for progress in self.reference.converge(self.seconds):
            yield f"reference of {LIGHT[self.transport]}", progress
        if "b" not in self.methods:
            yield "finding equal times", 0.0
            self.methods |= self.equal_cost_methods(self.methods["a"])
        true = self.reference.image * self.scale
        self.rows = [Row(role, method, true, self.scale) for role, method in self.methods.items()]
        turns = [(number, row) for number in range(self.rounds + 1) for row in self.rows]
        for k, (number, row) in enumerate(turns, 1):
            row.measure(number)
            yield "rendering in turn", k / len(turns)

    def equal_cost_methods(self, a: Method) -> dict[str, Method]:
        """Returns the method ``b``, which is not adaptive, with as many samples as ``a``, and with about the same
        rendering time, within about 10 % if one of the first four tried sample counts achieves this; both by the median
        of the seeds that are measured later, because ``a`` may need other samples with each.
        """
        a.render(0)  # compiles the kernels
        measured = [a.render(number)[1:] for number in range(1, self.rounds + 1)]
        samples = max(round(float(np.median([counts.mean() for counts, *_ in measured]))), 1)
        target_seconds = float(np.median([cpu for *_, cpu in measured]))

        def processor_seconds(method: Method) -> float:
            method.render(0)  # compiles the kernels
            return float(np.median([method.render(0)[3] for _ in range(3)]))

        spp, at_equal_time = samples, self.at(samples, self.b)
        for _ in range(4):  # repeated, because a part of a render's time does not depend on the sample count
            ratio = target_seconds / processor_seconds(at_equal_time)
            if 0.9 < ratio < 1.1:
                break
            spp = min(max(round(spp * ratio), 1), 4096)
            at_equal_time = self.at(spp, self.b)
        return {"b at equal samples": self.at(samples, self.b), "b at equal time": at_equal_time}
