"""Renders converged reference images, and measures the time and the error of methods in interleaved renders."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import numpy as np

from ..engine import environment
from . import measures
from .methods import Method

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
