"""Rendering for measurement: converged references that are kept on disk, and timed runs by turns."""

from __future__ import annotations

import hashlib
import io
import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import atomic
from ..denoising import halves
from ..engine import origin

#: Name -> function of an image and its reference.
Measures = Mapping[str, Callable[[np.ndarray, np.ndarray], float]]

#: Called with the part done, 0 to 1.
Tell = Callable[[float], None]

#: Seeds of references begin here, so that no measured image shares samples with its reference.
REFERENCE_SEEDS = 1 << 20


@dataclass
class Contestant:
    """An integrator with a scene (whose sensor brings the sampler), and a sample count.

    ``spp`` 0: the count is the integrator's own affair.
    """

    name: str
    scene: mi.Scene
    integrator: mi.Integrator
    spp: int = 0
    #: The same integrator with the AOV "samples", if it decides on the counts by itself.
    counting: mi.Integrator | None = None
    #: The :class:`Reference` that its images are measured against, and what both are multiplied by first.
    reference: Reference | None = None
    scale: float = 1.0
    #: Whether its samples are parted in halves, and the image is denoised.
    denoised: bool = False

    def measure(self, image: np.ndarray, measures: Measures) -> dict[str, float]:
        """Value of each of the ``measures`` (name -> function) for an image."""
        assert self.reference is not None
        image, wanted = image * self.scale, self.reference.image * self.scale
        return {name: measure(image, wanted) for name, measure in measures.items()}

    def render(self, seed: int) -> tuple[np.ndarray, tuple[float, float]]:
        """Image (height, width, 3) and the seconds that it took, by the clock and of processor time per thread."""
        start, start_cpu = time.perf_counter(), time.process_time()
        sensor = self.scene.sensors()[0]
        if self.denoised:
            image = halves.render(self.scene, sensor, self.integrator, seed, self.spp).final
        else:
            image = self.integrator.render(self.scene, sensor, seed=seed, spp=self.spp)
        dr.eval(image)
        dr.sync_thread()
        seconds, cpu = time.perf_counter() - start, time.process_time() - start_cpu
        return np.array(image)[..., :3], (seconds, cpu / max(dr.thread_count(), 1))

    def counts(self, seed: int = 0) -> np.ndarray:
        """Samples that each pixel really gets, shape (height, width); samplers round what they are asked for."""
        sensor = self.scene.sensors()[0]
        if self.counting is not None:
            if self.denoised:
                return halves.halves(self.scene, sensor, self.counting, seed, self.spp).others()["samples"]
            image = self.counting.render(self.scene, sensor, seed=seed, spp=self.spp)
            return np.array(image)[..., -1]
        sampler = sensor.sampler().clone()
        sampler.set_sample_count((self.spp + 1) // 2 if self.denoised else self.spp)
        width, height = sensor.film().crop_size()
        return np.full((height, width), float(sampler.sample_count() * (1 + self.denoised)))


@dataclass
class Runs:
    """What the runs of one contestant gave: one entry a round, but for ``cold``, the seconds of the first run."""

    contestant: Contestant
    counts: np.ndarray
    cold: float
    seconds: list[float] = field(default_factory=list)
    #: Processor time divided by the number of threads: what ``seconds`` would be on a machine with nothing else to do
    #: and all threads at work.
    cpu: list[float] = field(default_factory=list)
    errors: list[dict[str, float]] = field(default_factory=list)
    image: np.ndarray | None = None

    @property
    def samples(self) -> float:
        """Samples of a pixel, the mean."""
        return float(np.mean(self.counts))

    def median(self, what: str) -> float:
        """Median of "seconds", "cpu" or a measure of error."""
        return float(np.median(self.spread(what)))

    def spread(self, what: str) -> list[float]:
        """All rounds' "seconds", "cpu" or values of a measure of error, in ascending order."""
        return sorted(getattr(self, what) if what in ("seconds", "cpu") else [e[what] for e in self.errors])


def by_turns(
    contestants: Sequence[Contestant], rounds: int, measures: Measures, tell: Tell = lambda done: None
) -> list[Runs]:
    """Renders each contestant once to warm up and then once in each of ``rounds`` rounds; a list of :class:`Runs`.

    By turns, so that whatever else the machine does slows down all of them alike. ``tell`` is called with the part
    done, in time, as far as can be known.
    """
    results: list[Runs] = []
    turns: list[list[float]] = [[] for _ in contestants]  # seconds of each

    def took(k: int, begun: float) -> None:
        turns[k].append(time.perf_counter() - begun)
        tell(part_of_turns(turns, rounds + 1))

    for k, contestant in enumerate(contestants):
        begun = time.perf_counter()
        _, (cold, _) = contestant.render(0)
        results.append(Runs(contestant, contestant.counts(), cold))
        took(k, begun)
    for seed in range(1, rounds + 1):
        for k, result in enumerate(results):
            begun = time.perf_counter()
            image, (seconds, cpu) = result.contestant.render(seed)
            result.seconds.append(seconds)
            result.cpu.append(cpu)
            result.errors.append(result.contestant.measure(image, measures))
            result.image = image
            took(k, begun)
    return results


def part_of_turns(turns: Sequence[Sequence[float]], each: int) -> float:
    """The part of the time that has passed where everyone has ``each`` turns, those still to come taking as long as
    their last. ``turns``: seconds of the turns so far, of everyone.
    """
    known = [seconds[-1] for seconds in turns if seconds]
    guess = sum(known) / len(known)
    left = sum((each - len(seconds)) * (seconds[-1] if seconds else guess) for seconds in turns)
    passed = sum(map(sum, turns))
    return passed / (passed + left) if left else 1.0


@dataclass
class Reference:
    """A converged image, the mean of several estimators' means by the inverse of their variances."""

    image: np.ndarray
    #: Standard error of a pixel's channel: root mean square over the image.
    error: float
    seconds: float
    passes: list[int]
    #: Root mean square difference of the first two estimators over what their noise lets expect (1: they agree), or
    #: None with one estimator; and the difference of their means over its standard error.
    disagreement: float | None = None
    mean_difference: float | None = None


def reference(
    folder: str | Path, key: str, estimators: Sequence[Contestant], seconds: float, tell: Tell = lambda done: None
) -> Reference:
    """Renders the estimators (contestants of the same expected image) by turns for ``seconds`` seconds.

    Sums are kept in ``folder`` under ``key``, any text that identifies the image; a later call goes on from there, if
    it grants more time. At least three passes each.
    """
    path = Path(folder) / f"{hashlib.sha256(key.encode()).hexdigest()[:20]}.npz"
    spent, count, means = 0.0, 0, []
    sums = squares = np.zeros(1)
    if path.exists():
        with np.load(path) as kept:
            spent, count, sums, squares, means = (kept[n] for n in ("spent", "count", "sums", "squares", "means"))
        spent, count, means = float(spent), int(count), means.tolist()
    begun = count
    if spent < seconds:
        tell(spent / seconds)
    while count < 3 or spent < seconds:
        start = time.perf_counter()
        images = np.array([e.render(REFERENCE_SEEDS + count)[0] for e in estimators], dtype=np.float64)
        sums = sums + images if count else images
        squares = squares + images**2 if count else images**2
        means.append(images.mean(axis=(1, 2, 3)).tolist())
        count += 1
        spent += time.perf_counter() - start
        tell(min(spent / seconds, 1.0) if seconds else 1.0)
    if count > begun:
        content = io.BytesIO()
        np.savez(content, spent=spent, count=count, sums=sums, squares=squares, means=means)
        atomic.write({path: content.getvalue()})
    mean = sums / count
    variance = np.maximum(squares / count - mean**2, 0) / (count - 1)
    total = variance.mean(axis=(1, 2, 3))
    if np.any(total == 0):  # an image without noise
        return Reference(mean[np.argmin(total)], 0.0, spent, [count] * len(estimators))
    weights = 1 / total / np.sum(1 / total)
    result = Reference(
        np.tensordot(weights, mean, 1), float(np.sqrt(np.sum(weights**2 * total))), spent, [count] * len(estimators)
    )
    if len(estimators) > 1:
        result.disagreement = float(np.sqrt(np.mean((mean[0] - mean[1]) ** 2) / (total[0] + total[1])))
        differences = np.diff(np.array(means)[:, :2], axis=1)[:, 0]
        error = np.std(differences, ddof=1) / np.sqrt(count)
        result.mean_difference = float(np.mean(differences) / error) if error > 0 else 0.0
    return result


@dataclass
class Part:
    """What is run in one transport of light: the rows of the table, by role, and the curves, by role and level.

    Roles are "a", "b", "b at equal samples" and "b at equal time" for rows, "a" and "b" for curves; a level is the
    square root of the sample count that is asked for. Before they are rendered these are contestants, then runs.
    """

    transport: str
    reference: Reference
    rows: dict[str, Any]
    curves: dict[str, dict[int, Any]]

    def each(self, change: Callable[[Any], Any]) -> Part:
        """The same with every contestant replaced by what ``change`` makes of it, rows first."""
        rows = {role: change(row) for role, row in self.rows.items()}
        return Part(
            self.transport,
            self.reference,
            rows,
            {role: {level: change(point) for level, point in curve.items()} for role, curve in self.curves.items()},
        )


def cache_folder() -> Path:
    """Where references are kept by default."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mitsuba-prosim" / "references"


def machine() -> dict[str, str | int | float | None]:
    """The machine in words: processor, number of cores, versions."""
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
