"""Functions that all benchmarks share: references, runs in turn, errors, and bootstrap intervals of gains.

Errors are squared and have three measures. ``tone-mapped`` is measured after a square root. ``relMSE`` is the squared
error over the squared reference plus 0.01 (Rousselle et al. 2011). ``FLIP`` is the square of the mean of FLIP
(Andersson et al. 2020). So all three fall as one over the number of samples. The cost is processor time. The efficiency
of a run is 1 / (error x cost). The gain of run a over run b is the quotient of their efficiencies. Runs take turns, so
that a change of the machine's speed affects all runs equally.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from mitsuba_prosim.compare import measures
from subjects import NAMES, Subject

#: The first seed of references; measured runs have smaller seeds.
REFERENCE_SEEDS = 1 << 20


def tone_mapped_error(image: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Root mean square error of the channels of each pixel after a square root, shape (height, width), without
    clipping.
    """
    difference = np.sqrt(np.maximum(image, 0)) - np.sqrt(np.maximum(reference, 0))
    return np.sqrt(np.mean(np.square(difference), axis=2))


MEASURES: dict[str, Callable[[np.ndarray, np.ndarray], float]] = {
    "tone-mapped": lambda image, reference: float(np.mean(np.square(tone_mapped_error(image, reference)))),
    "relMSE": lambda image, reference: float(np.mean(np.square(image - reference) / (np.square(reference) + 0.01))),
    "FLIP": lambda image, reference: float(measures.flip_map(image, reference).mean()) ** 2,
}


@dataclass
class Run:
    """One integrator on one scene, and the errors and times of its images; each list has one entry per round."""

    name: str
    scene: mi.Scene
    integrator: dict[str, Any]
    spp: int = 0
    errors: list[list[float]] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    image: np.ndarray | None = None

    def __post_init__(self) -> None:
        self.loaded = mi.load_dict(self.integrator)

    def render(self, seed: int) -> tuple[np.ndarray, float]:
        """Returns ``(image, processor seconds)``; the image has shape (height, width, 3)."""
        begun = time.process_time()
        image = mi.render(self.scene, integrator=self.loaded, seed=seed, spp=self.spp)
        dr.eval(image)
        dr.sync_thread()
        return np.array(image, dtype=np.float64)[..., :3], time.process_time() - begun

    def samples(self) -> np.ndarray:
        """Returns the number of samples of each pixel, shape (height, width)."""
        integrator = self.integrator["nested"] if self.integrator["type"] == "prosim_denoised" else self.integrator
        if not integrator["type"].startswith("prosim"):
            sampler = self.scene.sensors()[0].sampler().clone()
            sampler.set_sample_count(self.spp)
            width, height = self.scene.sensors()[0].film().crop_size()
            return np.full((height, width), float(sampler.sample_count()))
        counting = mi.load_dict(integrator | {"aovs": "samples"})
        return np.array(mi.render(self.scene, integrator=counting, seed=0, spp=self.spp))[..., -1]


def render_in_turn(
    entries: Sequence[Run], reference: np.ndarray, rounds: int, chosen: Sequence[str] = tuple(MEASURES)
) -> None:
    """Renders each entry once for warming up, and then once in each round; stores errors and times in the entries.

    Images are scaled so that the mean of the reference is 0.25 (white is 1).
    """
    scale = 0.25 / reference.mean()
    for seed in range(rounds + 1):
        for entry in entries:
            image, seconds = entry.render(seed)
            if seed:
                entry.seconds.append(seconds)
                entry.errors.append([MEASURES[name](image * scale, reference * scale) for name in chosen])
                entry.image = image


def renders(entries: Sequence[Run], rounds: int) -> list[list[np.ndarray]]:
    """Returns the images of each entry, one image per round, and stores the processor seconds in the entry.

    A first image of each entry, for warming up, is not returned.
    """
    images: list[list[np.ndarray]] = [[] for _ in entries]
    for seed in range(rounds + 1):
        for entry, of in zip(entries, images):
            image, seconds = entry.render(seed)
            if seed:
                of.append(image)
                entry.seconds.append(seconds)
    return images


def interval(ratio: Callable[[np.ndarray], np.ndarray], rounds: int, draws: int = 2000) -> np.ndarray:
    """Returns the value of ``ratio`` and its 95 % bootstrap interval, shape (3, ...).

    ``ratio`` is a function of the indices of the rounds.
    """
    rng = np.random.default_rng(1)
    values = np.array([ratio(rng.integers(0, rounds, rounds)) for _ in range(draws)])
    return np.stack([ratio(np.arange(rounds)), *np.percentile(values, [2.5, 97.5], axis=0)])


def gain(a: Run, b: Run, cost: str = "seconds") -> np.ndarray:
    """Returns how many times cheaper run a is than run b for an equal error, with 95 % intervals: shape (3, measures).

    ``cost`` is "seconds" (processor time) or "samples".
    """
    seconds = [np.array(run.seconds) for run in (a, b)]
    errors = [np.array(run.errors) for run in (a, b)]
    samples = [run.samples().mean() for run in (a, b)] if cost == "samples" else [1.0, 1.0]

    def ratio(k: np.ndarray) -> np.ndarray:
        """Returns the gain for the rounds with the indices ``k``, for each measure."""
        costs = samples if cost == "samples" else [np.median(s[k]) for s in seconds]
        return errors[1][k].mean(axis=0) * costs[1] / (errors[0][k].mean(axis=0) * costs[0])

    return interval(ratio, len(a.seconds))


def shown(value: np.ndarray) -> str:
    """Formats a value and its interval, shape (3,), as a cell of a table."""
    return f"{value[0]:.2f} ({value[1]:.2f}–{value[2]:.2f})"


def reference(
    subject: Subject,
    integrator: dict[str, Any],
    spp: int,
    seconds: float,
    cache: Path,
    first_seed: int = REFERENCE_SEEDS,
) -> np.ndarray:
    """Returns the mean of many images of ``spp`` samples (0: the integrator's own number), and stores it in ``cache``.

    Rendering the images takes ``seconds`` of processor time. They have the seeds from ``first_seed``.
    """
    key = f"{subject} {integrator} {spp} {seconds} {first_seed} {mi.variant()} {mi.__version__}"
    path = cache / f"{hashlib.sha256(key.encode()).hexdigest()[:20]}.npy"
    if path.exists():
        return np.load(path)
    run, total, count, begun = Run("", subject.load(), integrator, spp), 0.0, 0, time.process_time()
    while count < 2 or time.process_time() - begun < seconds:
        total = total + run.render(first_seed + count)[0]
        count += 1
    cache.mkdir(parents=True, exist_ok=True)
    buffer = io.BytesIO()
    np.save(buffer, total / count)
    path.write_bytes(buffer.getvalue())
    return total / count


def arguments(description: str | None, rounds: int = 10) -> argparse.ArgumentParser:
    """Returns a parser of the options that all benchmarks have."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", nargs="+", metavar="NAME")
    parser.add_argument("--folder", type=Path, help="folder of the scenes by other authors")
    parser.add_argument("--size", type=int, default=256, help="width in pixels")
    parser.add_argument("--rounds", type=int, default=rounds, help="number of measured images, each with another seed")
    parser.add_argument("--reference-seconds", type=float, default=120)
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--cache", type=Path, default=Path.home() / ".cache" / "mitsuba-prosim" / "references")
    return parser


def begin(options: argparse.Namespace) -> None:
    """Chooses the scenes, sets Mitsuba's variant and log level, and registers the plugins."""
    if options.scene is None:
        folder = options.folder
        options.scene = NAMES if folder is None else sorted(path.parent.name for path in folder.glob("*/scene.xml"))
    mi.set_variant(options.variant)
    import mitsuba_prosim  # noqa: F401  (registers the plugins)

    mi.set_log_level(mi.LogLevel.Error)
