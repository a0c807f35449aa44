"""What is asked for and what is reached: the ``noise`` and the ``time`` of an image.

    python benchmarks/promises.py [--scene palito ...] [--size 64] [--seeds 100] [--row-seconds 60]
    python benchmarks/promises.py --time 1 5 20 --scene palito penumbra --size 256

For each scene two noises are asked for, a half and a fifth of what the first wave leaves, to one digit. Printed is the
ratio of the error that was really reached to the one asked for, over the seeds: the error is the root mean square over
the pixels of the difference of the displayed luminance to that of a converged image (whose noise is subtracted).
"kept": the share of the images between 0.7 and 1.05. "said": what the engine itself measured in the end, and "slope":
the error by the slope of the tone curve at the true value, by which a bright spot counts in full, both over what was
asked for (medians).
"""

from __future__ import annotations

import argparse
import statistics
import time

import numpy as np
from suite import NAMES, Reference, Subject, arguments, begin, luminance

#: Where the error of an image may lie, as a share of what was asked for.
KEPT = (0.7, 1.05)


def tone_curve(mean: np.ndarray) -> np.ndarray:
    """What is displayed of a luminance."""
    return np.sqrt(np.maximum(mean, 0) + 0.01)


def errors(image: np.ndarray, reference: Reference) -> tuple[float, float]:
    """Root mean square error of an image in display units, by the slope of the tone curve at the true value and by the
    curve itself.
    """
    wanted, slope = luminance(reference.image), 1 / (2 * tone_curve(luminance(reference.image)))
    noise = slope * (luminance(reference.first) - luminance(reference.second)) / 2
    found = [slope * (luminance(image) - wanted), tone_curve(luminance(image)) - tone_curve(wanted)]
    by_slope, by_curve = (float(np.sqrt(max(np.mean(f**2) - np.mean(noise**2), 0))) for f in found)
    return by_slope, by_curve


def one_digit(x: float) -> float:
    """``x`` to one digit."""
    return float(f"{x:.0e}")


def noises(subject: Subject, reference: Reference, options: argparse.Namespace) -> None:
    """Prints a row for each policy and noise."""
    begun = subject.integrator(adaptive="none", samples=options.samples, max_samples=options.samples)
    left = statistics.median(errors(subject.render(begun, seed), reference)[1] for seed in range(5))
    for share in (2, 5):
        asked = one_digit(left / share)
        for policy in options.policy:
            integrator = subject.integrator(adaptive=policy, samples=options.samples, noise=asked)
            ratios, slope, said, samples = [], [], [], []
            start = time.process_time()
            for seed in range(options.seeds):
                render = integrator.progressive(subject.scene, seed=seed).run()
                by_slope, by_curve = errors(np.array(render.image(), dtype=np.float64), reference)
                ratios.append(by_curve / asked)
                slope.append(by_slope / asked)
                said.append(render.reached.noise / asked)
                samples.append(render.reached.samples)
                if seed >= 9 and time.process_time() - start > options.row_seconds:
                    break
            kept = np.mean([KEPT[0] <= r <= KEPT[1] for r in ratios])
            low, middle, high = np.percentile(ratios, [2.5, 50, 97.5])
            print(
                f"| {subject.name} | {asked:g} | `{policy}` | {len(ratios)} | {kept:.0%} | {low:.2f} | {middle:.2f} | "
                f"{high:.2f} | {np.median(said):.2f} | {np.median(slope):.2f} | {np.mean(samples):.0f} |",
                flush=True,
            )


def times(subject: Subject, options: argparse.Namespace) -> None:
    """Prints a row for each time."""
    for asked in options.time:
        integrator = subject.integrator(adaptive=options.policy[0], samples=options.samples, time=asked)
        taken, samples = [], []
        for seed in range(1 if asked > 10 else options.seeds):
            start = time.perf_counter()
            render = integrator.progressive(subject.scene, seed=seed).run()
            taken.append(time.perf_counter() - start)
            samples.append(render.reached.samples)
        print(
            f"| {subject.name} | {asked:g} | {taken[0] / asked:.3f} | {min(taken) / asked:.3f} | "
            f"{max(taken) / asked:.3f} | {np.mean(samples):.0f} |",
            flush=True,
        )


def main() -> None:
    parser = arguments(__doc__, 64)
    parser.add_argument("--scene", nargs="+", choices=NAMES, default=NAMES)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--samples", type=int, default=5, help="N")
    parser.add_argument("--policy", nargs="+", default=["graded", "none"])
    parser.add_argument("--time", nargs="+", type=float, default=[], help="measure these seconds, not the noise")
    parser.add_argument("--row-seconds", type=float, default=60, help="processor time for a row, ten images at least")
    options = parser.parse_args()
    begin(options.variant, options.threads)
    if options.time:
        print("| | asked s | first | least | most | samples |\n|---" + "|---:" * 5 + "|")
    else:
        print("| | asked | | images | kept | 2.5 % | 50 % | 97.5 % | said | slope | samples |")
        print("|---|---:|---|" + "---:|" * 8)
    for name in options.scene:
        subject = Subject(name, options.size)
        if options.time:
            times(subject, options)
        else:
            noises(subject, subject.reference(options.cache, options.reference_seconds), options)
        del subject


if __name__ == "__main__":
    main()
