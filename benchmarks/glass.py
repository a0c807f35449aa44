"""Light through glass: error against processor time, with photons and by Mitsuba's ``path``.

    python benchmarks/glass.py tumbler [--rounds 3] [--reference-seconds 200]
    python benchmarks/glass.py ball [--rounds 5] [--reference-seconds 200]
    python benchmarks/glass.py dull

``tumbler``: the scene ``copo`` with caustics, 456 x 548 pixels, as many as 500²; the 99th percentile of the tone-mapped
error. ``ball``: the bright spot of figure 5.18 (``caustica``, 120 x 90), its noise by the tree and by every path beside
that of ``path``, and how the variance of every path divides. ``dull``: time with caustics over that without, in a scene
that has nothing specular.

Seconds are processor seconds of all threads together, medians of warm runs.
"""

from __future__ import annotations

import statistics
import time
import warnings

import mitsuba as mi
import numpy as np
import prosim_scene
from mitsuba_prosim.compare.measures import percentile99, rmse
from scenes import BuiltScene, penumbra
from suite import EXAMPLES, arguments, begin

TUMBLER, BALL = (456, 548), (120, 90)

#: The bright spot of figure 5.18, of an image 120 pixels wide: rows, columns.
SPOT = (slice(52, 61), slice(59, 69))

EVERY = {"diffuse_bounces": -1, "max_level": -1}


def load(name, resolution):
    """``(scene, settings)`` of an example."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = prosim_scene.load(EXAMPLES / f"{name}.scn", resolution=resolution)
    settings = scene.pop("integrator")
    return mi.load_dict(scene), settings


def render(scene, integrator, seed, spp=0):
    """``(seconds, image)``."""
    start = time.process_time()
    image = np.array(mi.render(scene, integrator=integrator, seed=seed, spp=spp), dtype=np.float64)[..., :3]
    return time.process_time() - start, image


def reference(scene, integrator, seconds, spp=0):
    """The mean of images of so many processor seconds together."""
    total, count, begun = 0.0, 0, time.process_time()
    while count < 2 or time.process_time() - begun < seconds:
        total = total + render(scene, integrator, 1000 + count, spp)[1]
        count += 1
    return total / count


def tumbler(options):
    scene, settings = load("copo", TUMBLER)
    settings |= {"caustics": True}
    best = mi.load_dict(settings | {"adaptive": "none", "samples": 4, "caustic_photons": 1 << 22})
    converged = reference(scene, best, options.reference_seconds)
    cases = [{"samples": n, "adaptive": "none"} for n in (2, 3, 4)]
    cases += [{"samples": 3, "adaptive": "none", "rr_throughput": 0.0}]
    cases += [{"samples": 3, "adaptive": a} for a in ("neighbours", "graded")]
    cases += [{"samples": 2, "adaptive": "graded"}, {"samples": 3, "noise": 0.006}]
    print("| | CPU s | RMSE | tone-mapped, 99 % | samples |\n|---|---:|---:|---:|---:|")
    for case in cases:
        integrator = mi.load_dict(settings | case)
        runs = [render(scene, integrator, seed) for seed in range(options.rounds + 1)][1:]
        cells = [statistics.median(measure(im, converged) for _, im in runs) for measure in (rmse, percentile99)]
        name = ",".join(f"{k}={v}" for k, v in case.items())
        seconds = statistics.median(s for s, _ in runs)
        print(
            f"| `{name}` | {seconds:.1f} | {cells[0]:.5f} | {cells[1]:.4f} | {integrator.reached.samples:.1f} |",
            flush=True,
        )


def ball(options):
    scene, settings = load("caustica", BALL)
    photons = {"caustics": True, "adaptive": "none"}
    # The light of the tree alone, and every path; path follows the same with the scene's lamp alone.
    every = {"type": "prosim", "hide_emitters": True} | EVERY | photons
    cases = {
        "the tree": (settings | photons, ({"samples": 3}, {"samples": 8})),
        "every path": (every, ({"samples": 4}, {"samples": 12})),
    }
    path = mi.load_dict({"type": "path", "max_depth": -1, "hide_emitters": True})
    print("| | CPU s | noise of the spot, % | CPU s for 1 %, by a slope of -1/2 |\n|---|---:|---:|---:|")

    def show(name, row):
        for seconds, error in row:
            print(f"| {name} | {seconds:.2f} | {100 * error:.2f} | {seconds * (100 * error) ** 2:.2f} |", flush=True)

    for name, (common, variants) in cases.items():
        show(name, measured(scene, [(mi.load_dict(common | v), 0) for v in variants], options))
    for sampler in ("independent", "multijitter"):
        runs = [(path, 64), (path, 400)]
        show(f"path, {sampler}", measured(with_sampler("caustica", sampler), runs, options))
    # What the noise of every path is made of: by its photons alone, as the same paths are followed without them.
    stacks = {}
    for name, given in {"all": {}, "fewer photons": {"caustic_photons": 1 << 18}}.items():
        integrator = mi.load_dict(every | {"samples": 8} | given)
        stacks[name] = np.stack([render(scene, integrator, seed)[1][SPOT] for seed in range(4 * options.rounds)])
    variance = {name: stack.var(axis=0, ddof=1).mean() for name, stack in stacks.items()}
    by_photons = (variance["fewer photons"] - variance["all"]) / 3
    print(f"\nEvery path, N = 8: of its variance, photons make {by_photons / variance['all']:.1%}")


def measured(scene, runs, options):
    """For each (integrator, spp): seconds, and standard deviation over the mean of the spot."""
    result = []
    for integrator, spp in runs:
        made = [render(scene, integrator, seed, spp) for seed in range(2 * options.rounds + 1)][1:]
        spots = np.stack([image[SPOT] for _, image in made])
        deviation = np.sqrt(spots.var(axis=0, ddof=1).mean()) / spots.mean()
        result.append((statistics.median(s for s, _ in made), deviation))
    return result


def with_sampler(name, sampler):
    """The scene of an example for ``path``, with one of Mitsuba's samplers."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = prosim_scene.load(EXAMPLES / f"{name}.scn", resolution=BALL)
    scene.pop("integrator")
    scene["view"]["sampler"] = {"type": sampler, "sample_count": 64}
    return mi.load_dict(scene)


def dull(options):
    scene = BuiltScene(penumbra, 256, {}).load(None)
    integrators = [
        mi.load_dict({"type": "prosim", "samples": 8, "adaptive": "none", "caustics": c}) for c in (True, False)
    ]
    ratios = []
    for seed in range(10 * options.rounds + 1):
        pair = [render(scene, i, seed)[0] for i in integrators[:: 1 if seed % 2 else -1]][:: 1 if seed % 2 else -1]
        ratios.append(pair[0] / pair[1])
    print(f"caustics over none, nothing specular: {statistics.median(ratios[1:]):.3f} times the time")


def main():
    parser = arguments(__doc__, 0)
    parser.add_argument("what", choices=["tumbler", "ball", "dull"])
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    begin(options.variant, options.threads)
    {"tumbler": tumbler, "ball": ball, "dull": dull}[options.what](options)


if __name__ == "__main__":
    main()
