"""How equal the times of an image's parts are, and how much more they take than the whole.

    python benchmarks/parts.py [--of 8] [--size 512] [--samples 4] [--rounds 2] [--scenes palito aranha copo]

Renders each part of each scene, in one process that has compiled the kernels, by each policy; the least processor time
of the rounds counts. "spread" is the longest over the mean, "price" what all take over what the whole takes.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

EXAMPLES = Path(__file__).parents[1] / "examples"


def timed(scene: Any, part: Any = None) -> tuple[float, int]:
    """``(seconds of the processors, samples)`` of a part, or of the whole image."""
    start = time.process_time()
    render = scene.integrator().progressive(scene, seed=1, part=part).run()
    return time.process_time() - start, int(np.sum(np.array(render.state.estimate.count), dtype=np.int64))


def measure(name: str, policy: str, of: int, size: int, n: int, rounds: int) -> None:
    import prosim_scene
    from mitsuba_prosim.engine.part import Part

    made = prosim_scene.load(EXAMPLES / f"{name}.scn", resolution=(size, size), samples=n)
    made["integrator"]["adaptive"] = policy
    scene = mi.load_dict(made)
    asked = [None, *(Part(number, of) for number in range(1, of + 1))]
    for part in asked[:2]:
        timed(scene, part)  # compiles
    found = np.array([[timed(scene, part) for part in asked] for _ in range(rounds)]).min(axis=0)
    seconds, samples = found.T
    mean, most = seconds[1:].mean(), samples[1:].mean()
    print(
        f"{name}, {policy}: whole {seconds[0]:.2f} s; parts {' '.join(f'{s:.2f}' for s in seconds[1:])}: spread "
        f"{seconds[1:].max() / mean:.3f} (of samples {samples[1:].max() / most:.3f}), price "
        f"{seconds[1:].sum() / seconds[0]:.2f} (of samples {samples[1:].sum() / samples[0]:.2f})",
        flush=True,
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in (("of", 8), ("size", 512), ("samples", 4), ("rounds", 2)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--scenes", nargs="+", default=["palito", "aranha", "copo"])
    parser.add_argument("--policies", nargs="+", default=["none", "neighbours", "graded"])
    asked = parser.parse_args()
    mi.set_variant("llvm_ad_rgb")
    import mitsuba_prosim  # noqa: F401  (registers the plugins)

    for scene in asked.scenes:
        for policy in asked.policies:
            measure(scene, policy, asked.of, asked.size, asked.samples, asked.rounds)
