"""Where samples go, and what it gains: adaptive sampling beside as many samples everywhere, and its bias.

    python benchmarks/allocation.py [--scene palito ...] [--size 96] [--samples 5 8] [--rounds 8]
    python benchmarks/allocation.py --bias 6000

For each scene and N the policies' thresholds are chosen so that a pixel gets about N² samples in the mean, as many as
with ``adaptive = none``; ``neighbours``, which gives N² at most, begins with an N 1.6 times as great, and ``graded,
smaller N``, whose patterns are then smaller than the mean, with one 1.6 times as small. Printed is how
many times less they cost than ``none`` for an equal error, the error being taken to go down with the root of the cost
(which is the same but for a few per cent): squared error times samples, and squared error times processor time, by
turns, medians.

``--bias``: that many images of a penumbra, 64 x 64, N = 5; the mean of the noisiest tenth of the pixels beside that of
``none`` with the same seeds.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import mitsuba as mi
import numpy as np
from mitsuba_prosim.compare import measures, runs
from scenes import BuiltScene, penumbra
from suite import NAMES, Reference, Subject, arguments, begin

#: From a scene, a seed and a threshold: the image (height, width, 3) and the mean number of samples.
Render = Callable[[Any, int, float], tuple[np.ndarray, float]]

MEASURES = ("RMSE", "tone-mapped", "99 %", "99.9 %")


def by_policy(policy: str, make: Callable[..., mi.Integrator], n: int, more: float = 1.6) -> Render:
    """How ``policy`` renders; ``make``: the integrator with some parameters; ``more``: so many times the N for
    ``neighbours``, and one over that for ``graded, smaller N``.
    """
    if policy == "graded, smaller N":
        integrator = make(adaptive="graded", samples=round(n / more), max_samples=4 * n * n)
    else:
        integrator = make(adaptive=policy, samples=round(more * n) if policy == "neighbours" else n)

    def render(scene: mi.Scene, seed: int, threshold: float) -> tuple[np.ndarray, float]:
        integrator.threshold = threshold
        progressive = integrator.progressive(scene, seed=seed).run()
        return np.array(progressive.image(), dtype=np.float64)[..., :3], progressive.reached.samples

    return render


def threshold_for(render: Render, scene: mi.Scene, samples: float) -> float:
    """The threshold by which a pixel gets about so many samples in the mean."""
    low, high = 1e-4, 1.0
    for _ in range(10):
        middle = (low * high) ** 0.5
        found = render(scene, 1000, middle)[1]
        if abs(found / samples - 1) < 0.05:
            break
        low, high = (middle, high) if found > samples else (low, middle)
    return middle


def squared_errors(image: np.ndarray, reference: Reference) -> np.ndarray:
    """Squares of :data:`MEASURES`; what the reference's own noise adds to the means is taken off."""
    tone = measures.tone_mapped_error(image, reference.image)
    noise = measures.tone_mapped_error(reference.first, reference.second) / 2
    return np.array(
        [
            measures.rmse(image, reference.image) ** 2 - measures.rmse(reference.first, reference.second) ** 2 / 4,
            np.mean(tone**2) - np.mean(noise**2),
            *(np.percentile(tone, [99, 99.9]) ** 2),
        ]
    )


@dataclass
class Runs:
    """What the images of one policy gave: one entry an image."""

    render: Render
    threshold: float
    errors: list[np.ndarray] = field(default_factory=list)
    samples: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    def take(self, scene: mi.Scene, seed: int, reference: Reference) -> None:
        """One more image."""
        start = time.process_time()
        image, samples = self.render(scene, seed, self.threshold)
        self.seconds.append(time.process_time() - start)
        self.samples.append(samples)
        self.errors.append(squared_errors(image, reference))

    def cost(self) -> np.ndarray:
        """Squared errors times samples, and times seconds, shape (2, measures)."""
        costs = np.array([np.mean(self.samples), np.median(self.seconds)])
        return costs[:, None] * np.mean(self.errors, axis=0)


def allocation(subject: Subject, n: int, reference: Reference, options: argparse.Namespace) -> None:
    """Prints a row for each policy."""
    found = {"none": Runs(by_policy("none", subject.integrator, n), 0.006)}
    for policy in options.policy:
        render = by_policy(policy, subject.integrator, n)
        found[policy] = Runs(render, threshold_for(render, subject.scene, n * n))
    for runs_of in found.values():
        runs_of.render(subject.scene, 999, runs_of.threshold)  # warm
    for seed in range(options.rounds):
        for runs_of in found.values():
            runs_of.take(subject.scene, seed, reference)
    uniform = found.pop("none")
    for policy, runs_of in found.items():
        samples, threshold = np.mean(runs_of.samples), runs_of.threshold
        gains = " | ".join(f"{gain:.2f}" for gain in (uniform.cost() / runs_of.cost()).ravel())
        print(f"| {subject.name} | {n} | `{policy}` | {threshold:.2g} | {samples:.1f} | {gains} |", flush=True)


def bias(images: int, policies: list[str]) -> None:
    """Prints a row for each policy: by how much the noisiest tenth of the pixels is too bright."""
    scene = BuiltScene(penumbra, 64, {}).load("independent")

    def make(**parameters: object) -> mi.Integrator:
        return mi.load_dict({"type": "prosim", "max_level": 0, **parameters})

    none = by_policy("none", make, 5)
    first = np.array([none(scene, runs.REFERENCE_SEEDS + seed, 0)[0].mean(axis=2) for seed in range(200)])
    noise = first.std(axis=0)
    noisiest = noise >= np.quantile(noise, 0.9)
    renders = {policy: by_policy(policy, make, 5, 1) for policy in policies}
    thresholds = dict.fromkeys(policies, 0.006) | {"thesis": 0.0025}
    means: dict[str, list[float]] = {policy: [] for policy in ["none", *policies]}
    for seed in range(images):
        means["none"].append(none(scene, seed, 0)[0][noisiest].mean())
        for policy, render in renders.items():
            image, samples = render(scene, seed, thresholds[policy])
            means[policy].append(image[noisiest].mean())
    print("| | threshold | samples | images | bias % | standard error |\n|---" + "|---:" * 5 + "|")
    true = np.mean(means["none"])
    for policy, render in renders.items():
        difference = 100 * (np.array(means[policy]) - means["none"]) / true
        samples = render(scene, 0, thresholds[policy])[1]
        print(
            f"| `{policy}` | {thresholds[policy]:.2g} | {samples:.1f} | {images} | {difference.mean():+.3f} | "
            f"{difference.std(ddof=1) / images**0.5:.3f} |",
            flush=True,
        )


def main() -> None:
    parser = arguments(__doc__, 96)
    parser.add_argument("--scene", nargs="+", choices=NAMES, default=NAMES)
    parser.add_argument("--samples", type=int, nargs="+", default=[5, 8], help="N")
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument("--policy", nargs="+", default=["graded", "graded, smaller N", "neighbours"])
    parser.add_argument("--bias", type=int, default=0, metavar="IMAGES", help="measure the bias, not the gain")
    options = parser.parse_args()
    begin(options.variant, options.threads)
    if options.bias:
        bias(options.bias, options.policy)
        return
    header = " | ".join(f"{cost}: {MEASURES[0]} | " + " | ".join(MEASURES[1:]) for cost in ("samples", "CPU s"))
    print(f"| | N | | threshold | samples | {header} |\n|---|---:|---|" + "---:|" * (2 + 2 * len(MEASURES)))
    for name in options.scene:
        subject = Subject(name, options.size)
        reference = subject.reference(options.cache, options.reference_seconds)
        for n in options.samples:
            allocation(subject, n, reference, options)
        del subject


if __name__ == "__main__":
    main()
