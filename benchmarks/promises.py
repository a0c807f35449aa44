"""Accuracy of stopping criteria: the error of images rendered with ``noise``, the duration of renders with ``time``.

    python benchmarks/promises.py [--scene palito ...] [--size 64] [--rounds 20]
    python benchmarks/promises.py --denoise --scene palito "Cornell box" --size 256
    python benchmarks/promises.py --time 1 5 --scene palito penumbra --size 256

``noise``: the requested noise is a half and a fifth of the noise of a first pass, rounded to one digit. The error is
the RMS difference between the displayed luminances of an image and of a converged image. The table has quantiles of the
ratio error / requested noise. The column ``kept`` is the proportion of images whose ratio is between 0.7 and 1.05, with
its exact 95 % interval (Clopper and Pearson).

``--denoise``: measures the image of ``prosim_denoised``, for a fifth and a twelfth of the noise of the first pass; the
column ``kept`` counts ratios between 0.6 and 1.1. The last column is the processor time of a raw image with the
requested noise over that of the denoised image, with its 95 % bootstrap interval.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from gains import NESTED
from measure import Run, arguments, begin, interval, reference, renders, shown
from scipy.stats import beta
from subjects import Subject

LUMINANCE = np.array([0.212671, 0.715160, 0.072169])


def error(image: np.ndarray, truth: np.ndarray) -> float:
    """Returns the RMS error of the displayed luminance, which is sqrt(luminance + 0.01), as in the engine."""
    shown = [np.sqrt(np.maximum(x @ LUMINANCE, 0) + 0.01) for x in (image, truth)]
    return float(np.sqrt(np.mean(np.square(shown[0] - shown[1]))))


def proportion(kept: int, of: int) -> str:
    """Formats the fraction ``kept / of`` and its exact 95 % interval."""
    low = beta.ppf(0.025, kept, of - kept + 1) if kept else 0.0
    high = beta.ppf(0.975, kept + 1, of - kept) if kept < of else 1.0
    return f"{kept / of:.0%} ({low:.0%}–{high:.0%})"


def noises(subject: Subject, options: argparse.Namespace) -> None:
    """Prints a row of the table for each requested noise."""
    scene, tree = subject.load(), subject.tree or NESTED
    uniform = tree | {"adaptive": "none", "samples": 8}
    truth = reference(subject, uniform, 0, options.reference_seconds, options.cache)
    first = Run("", scene, tree | {"adaptive": "none", "samples": 5, "max_samples": 5})
    begun = error(first.render(0)[0], truth)
    for asked in (float(f"{begun / part:.0e}") for part in ((5, 12) if options.denoise else (2, 5))):
        raw = Run("", scene, tree | {"noise": asked})
        run = Run("", scene, {"type": "prosim_denoised", "nested": raw.integrator}) if options.denoise else raw
        images = renders([run, raw] if options.denoise else [run], options.rounds)[0]
        ratios = np.array([error(image, truth) / asked for image in images])
        least, most = (0.6, 1.1) if options.denoise else (0.7, 1.05)
        share = proportion(int(np.sum((ratios >= least) & (ratios <= most))), options.rounds)
        low, middle, high = np.percentile(ratios, [2.5, 50, 97.5])
        seconds = np.array([raw.seconds, run.seconds])
        faster = interval(lambda k: np.divide(*np.median(seconds[:, k], axis=1)), options.rounds)  # noqa: B023
        last = shown(faster) if options.denoise else f"{run.samples().mean():.0f}"
        print(f"| {subject.name} | {asked:g} | {share} | {low:.2f} | {middle:.2f} | {high:.2f} | {last} |", flush=True)


def times(subject: Subject, options: argparse.Namespace) -> None:
    """Prints a row of the table for each requested time."""
    for asked in options.time:
        run, taken = Run("", subject.load(), (subject.tree or NESTED) | {"time": asked}), []
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
    options = parser.parse_args()
    begin(options)
    if options.time:
        print("| | seconds | first | least | most |\n|---" + "|---:" * 4 + "|")
    else:
        last = "time of the raw image" if options.denoise else "samples"
        print(f"| | noise | kept | 2.5 % | 50 % | 97.5 % | {last} |\n|---" + "|---:" * 6 + "|")
    for name in options.scene:
        (times if options.time else noises)(Subject(name, options.size, options.folder), options)


if __name__ == "__main__":
    main()
