"""Caustics from photons, compared with Mitsuba's path tracers: agreement of the mean images, and gains.

    python benchmarks/photons.py [--scene caustica "copper ring" ...] [--size 128] [--rounds 10]

Each scene is rendered with all light paths by ``prosim`` with photons, and by ``path`` (``volpath`` if glass absorbs)
with 256 samples per pixel. ``difference`` is the difference between the means of the whole images, in per cent. A
photon map blurs a caustic by about a pixel, so the mean loses light only at edges of the lit surface. Gains are in
processor time, for the mean squared tone-mapped error, and for the square of its 99.9th percentile. All cells have 95 %
intervals.
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
from measure import REFERENCE_SEEDS, Run, arguments, begin, interval, renders, shown, tone_mapped_error
from subjects import NAMES, Subject, lamp, rgb, sphere, stage, with_film

COPPER = {"type": "prosim_conductor", "material": "Cu"}
GLASS = {"type": "dielectric"}


def lamp_scene(**things: Any) -> dict[str, Any]:
    """Returns a scene of ``things`` on a floor, under a lamp that is just large enough for ``path`` to find it."""
    scene = stage(lamp=lamp([-2.6, 4.4, 0.8], 0.6, 40.0), **things)
    return {name: value for name, value in scene.items() if name in ("sensor", "floor", "lamp", *things)}


def ring() -> dict[str, Any]:
    """Returns a copper ring: the inner side of a cylinder."""
    ends = {"p0": [0, 0.02, 0], "p1": [0, 0.7, 0], "radius": 0.9}
    return {"type": "cylinder", "flip_normals": True, "bsdf": COPPER} | ends


GREEN = {"type": "homogeneous", "albedo": 0.0, "sigma_t": rgb(1.0, 0.3, 0.75)}
BODIES = {
    "glass ball": lambda: {"ball": sphere([0, 1, 0], 0.7, bsdf=GLASS)},
    "rough glass": lambda: {"ball": sphere([0, 1, 0], 0.7, bsdf={"type": "prosim_dielectric", "alpha": 0.15})},
    "copper ring": lambda: {"ring": ring()},
    "green glass": lambda: {"ball": sphere([0, 1, 0], 0.7, bsdf=GLASS, interior=GREEN)},
}


def load(name: str, size: int) -> mi.Scene:
    """Loads a scene of :data:`BODIES`, or an example scene."""
    if name in NAMES:
        return Subject(name, size).load()
    scene = with_film(lamp_scene(**BODIES[name]()), {"width": size, "height": size})
    return mi.load_dict({"type": "scene"} | scene)


def main() -> None:
    parser = arguments(__doc__)
    parser.set_defaults(scene=[*BODIES, "caustica"], size=128)
    options = parser.parse_args()
    begin(options)
    print("| | difference, % | time | tone-mapped | 99.9 % |\n|---" + "|---:" * 4 + "|")
    for name in options.scene:
        scene = load(name, options.size)
        every = {"diffuse_bounces": -1, "max_level": -1, "hide_emitters": True, "adaptive": "none"}
        theirs = {"type": "volpath" if name == "green glass" else "path", "hide_emitters": True}
        ours = Run("ours", scene, {"type": "prosim", "caustics": True, "samples": 8} | every)
        pair = (ours, Run("theirs", scene, theirs, 256))
        images = renders(pair, options.rounds)
        truth = np.mean([ours.render(REFERENCE_SEEDS + seed)[0] for seed in range(20)], axis=0)
        scale = 0.25 / truth.mean()
        for run, of in zip(pair, images):
            tone = [tone_mapped_error(image * scale, truth * scale) for image in of]
            run.errors = [[np.mean(t**2), np.percentile(t, 99.9) ** 2] for t in tone]

        def difference(k: np.ndarray) -> np.ndarray:
            """Returns the difference of the mean images in per cent, for the rounds with the indices ``k``."""
            a, b = (np.mean([of[i] for i in k]) for of in images)  # noqa: B023  (used at once)
            return np.array(100 * (a / b - 1))

        def gains(k: np.ndarray) -> np.ndarray:
            """Returns the gain for each measure, for the rounds with the indices ``k``."""
            a, b = (np.array(run.errors)[k].mean(axis=0) * np.median(np.array(run.seconds)[k]) for run in pair)  # noqa: B023
            return b / a

        apart, gained = interval(difference, options.rounds), interval(gains, options.rounds)
        times = np.median(np.array(pair[0].seconds) / np.array(pair[1].seconds))
        print(f"| {name} | {shown(apart)} | {times:.2f} | " + " | ".join(map(shown, gained.T)) + " |", flush=True)


if __name__ == "__main__":
    main()
