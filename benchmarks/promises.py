"""Accuracy of stopping criteria: the error of images rendered with ``noise``, the duration of renders with ``time``.

    python benchmarks/promises.py [--scene palito ...] [--size 64] [--rounds 20]
    python benchmarks/promises.py --folder SCENES [--denoise]
    python benchmarks/promises.py --denoise --scene palito "Cornell box" --size 256
    python benchmarks/promises.py --time 1 5 --scene palito penumbra --size 256

``--folder``: without ``--scene``, all scenes of the folder, ``FOLDER/NAME/scene.xml``, instead of ours.

``noise``: the three requested noises are the noise of a first pass divided by 1.5, 2.5 and 4, rounded to one digit.
The error is the RMS difference between the displayed luminances of an image and of a converged image. The table has the
median and the range of the ratio error / requested noise. The column ``kept`` is the proportion of images whose ratio
is between 0.7 and 1.05, with its exact 95 % interval (Clopper and Pearson). The column ``uncertain`` is the number of
images whose verdict contains this word. Each image that misses
the range is listed with its verdict, at once and at the end.

``--denoise``: measures the denoised image, and the raw image with the same requested noise, in turns; for the denoised
image, the column ``kept`` counts ratios between 0.6 and 1.1. The last column is the processor time of the raw image
over that of the denoised image, with its 95 % bootstrap interval.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass, field

import mitsuba as mi
import mitsuba_prosim
import numpy as np
from measure import REFERENCE_SEEDS, Run, arguments, begin, interval, reference, shown
from scipy.stats import beta
from subjects import Subject

LUMINANCE = np.array([0.212671, 0.715160, 0.072169])


def error(image: np.ndarray, *halves: np.ndarray) -> float:
    """Returns the RMS error of the displayed luminance, which is sqrt(luminance + 0.01), as in the engine.

    The product of the differences from two independent halves of the converged image does not contain their own noise.
    """
    image, *halves = [np.sqrt(np.maximum(x @ LUMINANCE, 0) + 0.01) for x in (image, *halves)]
    return float(np.sqrt(max(np.mean((image - halves[0]) * (image - halves[1])), 0)))


def proportion(kept: int, of: int) -> str:
    """Formats the fraction ``kept / of`` and its exact 95 % interval."""
    low = beta.ppf(0.025, kept, of - kept + 1) if kept else 0.0
    high = beta.ppf(0.975, kept + 1, of - kept) if kept < of else 1.0
    return f"{kept / of:.0%} ({low:.0%}–{high:.0%})"


#: Whether the image is denoised -> the range of the ratio error / requested noise that is promised.
KEPT = {False: (0.7, 1.05), True: (0.6, 1.1)}


@dataclass
class Images:
    """Images of one scene: ratios of the error to the requested noise ``asked``, verdicts, and processor seconds.

    None for ``asked``: the images of all requested noises.
    """

    name: str
    asked: float | None
    denoise: bool
    ratios: list[float] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)
    verdicts: list[str] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    samples: list[float] = field(default_factory=list)

    def add(self, scene: mi.Scene, seed: int, halves: list[np.ndarray]) -> None:
        """Renders an image, and measures its error with the two ``halves`` of the converged image."""
        begun = time.process_time()
        result = mitsuba_prosim.render(scene, self.asked, denoise=self.denoise, seed=seed, progress=False)
        self.seconds.append(time.process_time() - begun)
        self.samples.append(float(np.mean(result.samples)))
        self.verdicts.append(result.verdict)
        self.ratios.append(error(np.array(result)[..., :3], *halves) / self.asked)
        low, high = KEPT[self.denoise]
        if not low <= self.ratios[-1] <= high:
            self.missed.append(f"{self.name}, {self.asked:g}, seed {seed}: {self.ratios[-1]:.2f} ({result.verdict})")
            print(self.missed[-1], file=sys.stderr, flush=True)

    def extend(self, other: Images) -> None:
        """Adds the images ``other``."""
        for name in ("ratios", "missed", "verdicts", "seconds", "samples"):
            getattr(self, name).extend(getattr(other, name))

    def row(self, raw: Images) -> str:
        """Returns the row of the table; ``raw`` has the images without denoising."""
        count, uncertain = len(self.ratios), sum("uncertain" in words for words in self.verdicts)
        ratios = " | ".join(f"{ratio:.2f}" for ratio in np.percentile(self.ratios, [0, 50, 100]))
        share = proportion(count - len(self.missed), count)
        image = "denoised" if self.denoise else "raw"
        seconds = np.array([raw.seconds, self.seconds])
        faster = interval(lambda k: np.divide(*np.median(seconds[:, k], axis=1)), count)
        last = shown(faster) if self.denoise else f"{np.mean(self.samples):.0f}"
        asked = "all" if self.asked is None else f"{self.asked:g}"
        return f"| {self.name} | {image} | {asked} | {share} | {ratios} | {uncertain} | {last} |"


def noises(subject: Subject, options: argparse.Namespace) -> list[str]:
    """Prints a row of the table for each requested noise; returns the images that miss the range, in words."""
    scene, tree = subject.load(), subject.tree or subject.adaptive
    uniform = tree | {"adaptive": "none", "samples": 8}
    halves = [
        reference(subject, uniform, 0, options.reference_seconds / 2, options.cache, first * REFERENCE_SEEDS)
        for first in (1, 2)
    ]
    first = Run("", scene, tree | {"adaptive": "none", "samples": 5, "max_samples": 5})
    begun, kinds = error(first.render(0)[0], *halves), (False, True) if options.denoise else (False,)
    together = [Images(subject.name, None, denoise) for denoise in kinds]
    for asked in dict.fromkeys(float(f"{begun / part:.0e}") for part in (1.5, 2.5, 4)):
        found = [Images(subject.name, asked, denoise) for denoise in kinds]
        for seed in range(1, options.rounds + 1):
            for images in found:
                images.add(scene, seed, halves)
        for images, whole in zip(found, together):
            print(images.row(found[0]), flush=True)
            whole.extend(images)
    for whole in together:
        print(whole.row(together[0]), flush=True)
    return [words for whole in together for words in whole.missed]


def times(subject: Subject, options: argparse.Namespace) -> None:
    """Prints a row of the table for each requested time."""
    for asked in options.time:
        run, taken = Run("", subject.load(), (subject.tree or subject.adaptive) | {"time": asked}), []
        for seed in range(options.rounds):
            begun = time.perf_counter()
            run.render(seed)
            taken.append((time.perf_counter() - begun) / asked)
        print(
            f"| {subject.name} | {asked:g} | {taken[0]:.3f} | {min(taken[1:]):.3f} | {max(taken[1:]):.3f} |", flush=True
        )


def main() -> None:
    parser = arguments(__doc__, 20)
    parser.add_argument("--time", nargs="+", type=float, default=[], help="measure these time limits, in seconds")
    parser.add_argument("--denoise", action="store_true", help="measure the denoised image")
    parser.add_argument("--filter", default="box", help="the film's reconstruction filter")
    options = parser.parse_args()
    begin(options)
    subjects = [Subject(name, options.size, options.folder, options.filter) for name in options.scene]
    if options.time:
        print("| | seconds | first | least | most |\n|---" + "|---:" * 4 + "|")
        for subject in subjects:
            times(subject, options)
        return
    last = "time of the raw image" if options.denoise else "samples"
    print(f"| | image | noise | kept | least | 50 % | most | uncertain | {last} |\n|---|---" + "|---:" * 7 + "|")
    missed = [words for subject in subjects for words in noises(subject, options)]
    print("", f"{len(missed)} images miss the range:", *missed, sep="\n")


if __name__ == "__main__":
    main()
