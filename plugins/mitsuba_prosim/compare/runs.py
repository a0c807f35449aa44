"""Rendering for measurement: converged references on disk, and timed, interleaved runs."""

from __future__ import annotations

import hashlib
import io
import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import atomic
from ..denoising import halves
from ..engine import origin

#: Name -> function of an image and its reference.
Measures = Mapping[str, Callable[[np.ndarray, np.ndarray], float]]

#: A function of the progress, 0 to 1.
Tell = Callable[[float], None]

#: The first seed of references: measured images have other samples.
REFERENCE_SEEDS = 1 << 20


@dataclass(eq=False)
class Contestant:
    """An integrator with a scene, a sensor (and its sampler) and a sample count, 0 for that of the integrator."""

    name: str
    scene: mi.Scene
    sensor: mi.Sensor
    integrator: mi.Integrator
    spp: int = 0
    #: The same integrator with the AOV "samples", if it decides on the sample counts.
    counting: mi.Integrator | None = None
    #: Whether the image is denoised, from two halves of the samples.
    denoised: bool = False

    def render(self, seed: int) -> tuple[np.ndarray, float, float]:
        """Image (height, width, 3), seconds by the clock, and processor seconds per thread."""
        start, start_cpu = time.perf_counter(), time.process_time()
        if self.denoised:
            image = halves.render(self.scene, self.sensor, self.integrator, seed, self.spp).final
        else:
            image = self.integrator.render(self.scene, self.sensor, seed=seed, spp=self.spp)
        dr.eval(image)
        dr.sync_thread()
        seconds, cpu = time.perf_counter() - start, time.process_time() - start_cpu
        return np.array(image)[..., :3], seconds, cpu / max(dr.thread_count(), 1)

    def counts(self) -> np.ndarray:
        """The number of samples of each pixel, shape (height, width); samplers round the requested number."""
        if self.counting is not None:
            if self.denoised:
                return halves.DenoisedRender(self.scene, self.sensor, self.counting, 0, self.spp).run().counts()
            return np.array(self.counting.render(self.scene, self.sensor, seed=0, spp=self.spp))[..., -1]
        sampler = self.sensor.sampler().clone()
        sampler.set_sample_count((self.spp + 1) // 2 if self.denoised else self.spp)
        width, height = self.sensor.film().crop_size()
        return np.full((height, width), float(sampler.sample_count() * (1 + self.denoised)))


@dataclass
class Runs:
    """The results of one contestant: values of each round, by name ("seconds", "cpu" and the measures of error)."""

    counts: np.ndarray
    values: dict[str, list[float]] = field(default_factory=dict)
    image: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def samples(self) -> float:
        """The mean number of samples per pixel."""
        return float(np.mean(self.counts))

    def median(self, name: str) -> float:
        """Median of the rounds' values."""
        return float(np.median(self.values[name]))


def interleaved(
    references: Mapping[Contestant, np.ndarray], rounds: int, measures: Measures, tell: Tell = lambda done: None
) -> dict[Contestant, Runs]:
    """Renders each contestant once to warm up and then once in each of ``rounds`` rounds, and measures the images
    against its reference.

    Turns distribute the other load of the machine evenly.
    """
    results: dict[Contestant, Runs] = {}
    for turn in range(rounds + 1):
        for k, (contestant, reference) in enumerate(references.items()):
            image, seconds, cpu = contestant.render(turn)
            if turn == 0:
                results[contestant] = Runs(contestant.counts())
            else:
                runs = results[contestant]
                errors = {name: measure(image, reference) for name, measure in measures.items()}
                for name, value in {"seconds": seconds, "cpu": cpu, **errors}.items():
                    runs.values.setdefault(name, []).append(value)
                runs.image = image
            tell((turn * len(references) + k + 1) / ((rounds + 1) * len(references)))
    return results


@dataclass
class Reference:
    """A converged image: the mean of the estimators' means, weighted by the inverse of their variances."""

    image: np.ndarray
    #: RMS standard error of a pixel's channel.
    error: float
    seconds: float
    passes: int
    #: RMS difference of the two estimators over the expected noise (1: they agree), or None with one estimator.
    disagreement: float | None = None


def reference(
    folder: str | Path, key: str, estimators: Sequence[Contestant], seconds: float, tell: Tell = lambda done: None
) -> Reference:
    """Renders the estimators (contestants of the same expected image) in turn for ``seconds`` seconds, and at least
    three times each.

    Sums are cached in ``folder`` under ``key``, any text that identifies the image; a later call continues them.
    """
    path = Path(folder) / f"{hashlib.sha256(key.encode()).hexdigest()[:20]}.npz"
    spent, count = 0.0, 0
    sums = squares = np.zeros(1)
    if path.exists():
        with np.load(path) as cached:
            spent, count, sums, squares = (cached[name] for name in ("spent", "count", "sums", "squares"))
        spent, count = float(spent), int(count)
    started = count
    while count < 3 or spent < seconds:
        start = time.perf_counter()
        images = np.array([e.render(REFERENCE_SEEDS + count)[0] for e in estimators], dtype=np.float64)
        sums, squares, count = sums + images, squares + images**2, count + 1
        spent += time.perf_counter() - start
        tell(min(spent / seconds, 1.0) if seconds else 1.0)
    if count > started:
        content = io.BytesIO()
        np.savez(content, spent=spent, count=count, sums=sums, squares=squares)
        atomic.write({path: content.getvalue()})
    mean = sums / count
    variance = (np.maximum(squares / count - mean**2, 0) / (count - 1)).mean(axis=(1, 2, 3))
    if np.any(variance == 0):  # an image without noise
        return Reference(mean[np.argmin(variance)], 0.0, spent, count)
    weights = 1 / variance / np.sum(1 / variance)
    disagreement = None
    if len(estimators) > 1:
        disagreement = float(np.sqrt(np.mean((mean[0] - mean[1]) ** 2) / (variance[0] + variance[1])))
    error = float(np.sqrt(np.sum(weights**2 * variance)))
    return Reference(np.tensordot(weights, mean, 1), error, spent, count, disagreement)


def cache_folder() -> Path:
    """The default folder of references."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mitsuba-prosim" / "references"


def machine() -> dict[str, str | int | float | None]:
    """Processor, number of cores, versions and load of this machine."""
    here = origin.here()
    return {
        "processor": here["processor"],
        "cores": os.cpu_count(),
        "threads": dr.thread_count(),
        "system": platform.system(),
        "python": platform.python_version(),
        **{name: here[name] for name in origin.EXACT},
        "load": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
    }
