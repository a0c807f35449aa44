"""What ``prosim_adaptive`` adds to the time of the integrator that is nested in it.

    python benchmarks/nested.py [--size 256] [--samples 8] [--rounds 9]

The Cornell box, N² samples for every pixel, by turns: ``path`` within ``prosim_adaptive`` with ``adaptive = none``
beside ``path`` itself with Mitsuba's samplers. Printed is the median over the turns of the quotient of the processor
times, and that of the mean squared errors' roots.
"""

from __future__ import annotations

import argparse
import statistics
import time

import mitsuba as mi
import numpy as np
from scenes import BuiltScene, cornell_box
from suite import begin, nested

DEPTH = 8


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=256, help="width and height in pixels")
    parser.add_argument("--samples", type=int, default=8, help="N")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--threads", type=int, default=0)
    options = parser.parse_args()
    begin(options.variant, options.threads)
    box = BuiltScene(cornell_box, options.size, {})
    path = mi.load_dict({"type": "path", "max_depth": DEPTH})
    ours = mi.load_dict(nested(DEPTH) | {"adaptive": "none", "samples": options.samples})
    runs = {"prosim_adaptive": (ours, box.load("independent"), 0)}
    for sampler in ("independent", "multijitter"):
        runs[sampler] = (path, box.load(sampler), options.samples**2)
        given = nested(DEPTH) | {"adaptive": "none", "samples": options.samples, "sampler": {"type": sampler}}
        runs[f"prosim_adaptive, {sampler}"] = (mi.load_dict(given), runs["prosim_adaptive"][1], 0)
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    images: dict[str, list[np.ndarray]] = {name: [] for name in runs}
    for seed in range(options.rounds + 1):  # the first to warm up
        for name, (integrator, scene, spp) in runs.items():
            start = time.process_time()
            image = integrator.render(scene, scene.sensors()[0], seed=seed, spp=spp)
            images[name].append(np.array(image))
            seconds[name].append(time.process_time() - start)
    print("| | CPU s | times `path`, independent | times `path`, multijitter | error |\n|---" + "|---:" * 4 + "|")
    for name in runs:
        ratios = [
            statistics.median(a / b for a, b in zip(seconds[name][1:], seconds[sampler][1:]))
            for sampler in ("independent", "multijitter")
        ]
        noise = np.sqrt(np.mean(np.var(images[name], axis=0, ddof=1)))
        label = name if name.startswith("prosim") else f"path, {name}"
        cpu = statistics.median(seconds[name][1:])
        print(f"| `{label}` | {cpu:.2f} | {ratios[0]:.2f} | {ratios[1]:.2f} | {noise:.4f} |")


if __name__ == "__main__":
    main()
