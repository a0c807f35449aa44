"""Light through glass: error against processor time, with photons and by Mitsuba's ``path``.

    python benchmarks/glass.py tumbler [--rounds 3] [--reference-seconds 200]
    python benchmarks/glass.py ball [--rounds 5] [--reference-seconds 200]
    python benchmarks/glass.py dull

``tumbler``: the scene ``copo`` with caustics, 456 x 548 pixels, as many as 500²; the 99th percentile of the tone-mapped
error. ``ball``: figure 5.18 (``caustica``, 120 x 90), the noise of its bright spot, of the ball's shadow around it,
of what is diffuse, and of the ball, by the tree and by every path beside that of ``path``; then the same with a black
ball, which leaves the light from wall to wall, and with fewer photons. ``dull``: time with caustics over that without,
in a scene that has nothing specular.

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

#: The bright spot of figure 5.18 and the ball's shadow, of an image 120 pixels wide: rows, columns.
SPOT, SHADOW = (slice(52, 61), slice(59, 69)), (slice(40, 73), slice(57, 79))

EVERY = {"diffuse_bounces": -1, "max_level": -1}
FEWER = {"caustic_photons": 1 << 18}


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
        samples = integrator.progressive(scene).run().reached.samples
        print(f"| `{name}` | {seconds:.1f} | {cells[0]:.5f} | {cells[1]:.4f} | {samples:.1f} |", flush=True)


def ball(options):
    scene, settings = load("caustica", BALL)
    photons = {"caustics": True, "adaptive": "none"}
    # The light of the tree alone, and every path; path follows the same with the scene's lamp alone.
    every = {"type": "prosim", "hide_emitters": True} | EVERY | photons
    path = [(mi.load_dict({"type": "path", "max_depth": -1, "hide_emitters": True}), spp) for spp in (64, 256)]
    parts = parts_of(scene)
    titles = " | ".join(f"{part}, % | CPU s for 1 %" for part in parts)
    print(f"| | CPU s | {titles} |\n|---|---:|" + "---:|---:|" * len(parts))
    whole = mi.load_dict(every | {"samples": 8})

    def show(name, scene, runs, means):
        for integrator, spp in runs:
            made = [render(scene, integrator, seed, spp) for seed in range(2 * options.rounds + 1)][1:]
            seconds, images = statistics.median(s for s, _ in made), np.stack([image for _, image in made])
            cells = []
            for part, mean in means.items():
                noise = 100 * np.sqrt(images[:, parts[part]].var(axis=0, ddof=1).mean()) / mean
                cells.append(f"{noise:.2f} | {seconds * noise**2:.2f}")
            print(f"| {name} | {seconds:.2f} | {' | '.join(cells)} |", flush=True)

    def means(integrator):
        image = render(scene, integrator, 1)[1]
        return {part: image[where].mean() for part, where in parts.items()}

    tree = [(mi.load_dict(settings | photons | {"samples": n}), 0) for n in (3, 8)]
    show("the tree", scene, tree, means(tree[-1][0]))
    ours, of_all = [(mi.load_dict(every | {"samples": n}), 0) for n in (4, 8, 16)], means(whole)
    show("every path", scene, ours, of_all)
    show("every path, a quarter of the photons", scene, [(mi.load_dict(every | FEWER | {"samples": 8}), 0)], of_all)
    for sampler in ("independent", "multijitter"):
        show(f"`path`, {sampler}", with_sampler("caustica", sampler), path, of_all)
    black = with_sampler("caustica", "multijitter", dark=True)
    show("every path, black ball", black, ours[1:], of_all)
    show("`path`, multijitter, black ball", black, path, of_all)


def parts_of(scene, fine=8):
    """The pixels of the parts of figure 5.18, as masks: those that see something diffuse alone, and the others."""
    width, height = BALL
    x, y = np.meshgrid(
        (np.arange(width * fine) + 0.5) / (width * fine), (np.arange(height * fine) + 0.5) / (height * fine)
    )
    ray, _ = scene.sensors()[0].sample_ray(0, 0.5, mi.Point2f(x.ravel(), y.ravel()), mi.Point2f(0.5))
    flags = scene.ray_intersect(ray).bsdf().flags()
    ideal = np.array(mi.has_flag(flags, mi.BSDFFlags.Delta)).reshape(height, fine, width, fine).any(axis=(1, 3))
    result = {"spot": np.zeros_like(ideal), "shadow": np.zeros_like(ideal)}
    result["spot"][SPOT] = result["shadow"][SHADOW] = True
    return {name: mask & ~ideal for name, mask in result.items()} | {"diffuse": ~ideal, "ball": ideal}


def with_sampler(name, sampler, dark=False):
    """The scene of an example for ``path``, with one of Mitsuba's samplers; ``dark``: what is glass is black."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = prosim_scene.load(EXAMPLES / f"{name}.scn", resolution=BALL)
    scene.pop("integrator")
    scene["view"]["sampler"] = {"type": sampler, "sample_count": 64}
    for part in scene.values():
        if dark and isinstance(part, dict) and part.get("bsdf", {}).get("type") == "prosim_dielectric":
            part["bsdf"] = {"type": "diffuse", "reflectance": 0.0}
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
