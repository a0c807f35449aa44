"""Time and variance of each material and each light, compared with the most similar plugin of Mitsuba.

    python benchmarks/materials.py [--only conductor] [--size 256] [--rounds 10]

For a material, the scene is a ball and a floor of this material, a spherical light and a dim sky. For a light, the
scene is a diffuse ball and a diffuse floor under this light. Both plugins are rendered by ``path`` with 32 samples per
pixel. A cell is the ratio ours / theirs with its 95 % interval: the ratio of the times, and the ratio of the variances
of a pixel (mean over the image, divided by the squared mean). The models differ: our plugins use the shadowing of
V-cavities, Mitsuba's plugins use that of Smith. Phong's lobe and ``roughplastic`` are only similar. Mitsuba has no area
light with a spot distribution, so our spot is compared with Mitsuba's uniform ``area``.
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
from measure import Run, arguments, begin, interval, renders, shown
from subjects import diffuse, lamp, rectangle, sphere, with_film

CU = {"material": "Cu"}
HALF = {"diffuse_reflectance": 0.4}
AIMED = {"direction": [-2.0, -4.0, -2.0]}
MATERIALS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "lambertian": ({"type": "prosim_lambertian"}, {"type": "diffuse"}),
    "conductor, smooth": ({"type": "prosim_conductor", **CU}, {"type": "conductor", **CU}),
    "conductor, 0.1": (
        {"type": "prosim_conductor", "alpha": 0.1, **CU},
        {"type": "roughconductor", "alpha": 0.1, **CU},
    ),
    "conductor, 0.4": (
        {"type": "prosim_conductor", "alpha": 0.4, **CU},
        {"type": "roughconductor", "alpha": 0.4, **CU},
    ),
    **{
        f"multiple scattering, {alpha}, over {name}": (
            {"type": "prosim_conductor", "alpha": alpha, "multiple_scattering": True, **CU},
            {"type": other, "alpha": alpha, **CU},
        )
        for alpha in (0.2, 0.5, 1.0)
        for name, other in (("single", "prosim_conductor"), ("roughconductor", "roughconductor"))
    },
    "dielectric, smooth": ({"type": "prosim_dielectric"}, {"type": "dielectric"}),
    "dielectric, 0.1": ({"type": "prosim_dielectric", "alpha": 0.1}, {"type": "roughdielectric", "alpha": 0.1}),
    "composite, smooth": ({"type": "prosim_composite", **HALF}, {"type": "plastic", **HALF}),
    "composite, 0.1": (
        {"type": "prosim_composite", "alpha": 0.1, **HALF},
        {"type": "roughplastic", "alpha": 0.1, **HALF},
    ),
    "phong, exponent 50": ({"type": "prosim_phong", "exponent": 50.0}, {"type": "roughplastic", "alpha": 0.1}),
}


def ball_lamp(**emitter: Any) -> dict[str, Any]:
    """Returns a sphere with an ``emitter``."""
    return sphere([2, 4, 2], 0.5, emitter=emitter)


LIGHTS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "area": (ball_lamp(type="prosim_area", radiance=20.0), ball_lamp(type="area", radiance=20.0)),
    "area, spot": (
        ball_lamp(type="prosim_area", radiance=20.0, distribution="spot", exponent=8.0, **AIMED),
        ball_lamp(type="area", radiance=20.0),
    ),
    "point": (
        {"type": "prosim_point", "position": [2, 4, 2], "intensity": 20.0},
        {"type": "point", "position": [2, 4, 2], "intensity": 20.0},
    ),
}


def scene(size: int, look: dict[str, Any], light: dict[str, Any], sky: float) -> mi.Scene:
    """Returns the scene of the ball and the floor, whose material is ``look``; ``sky`` is the radiance of the sky."""
    view = mi.ScalarTransform4f().look_at([0, 3, 6], [0, 0.8, 0], [0, 1, 0])
    world = {
        "sensor": {"type": "perspective", "fov": 35, "to_world": view},
        "material": look | {"id": "material"},
        "ball": sphere([0, 1, 0], 1.0, bsdf={"type": "ref", "id": "material"}),
        "floor": rectangle({"type": "ref", "id": "material"}, lambda t: t.rotate([1, 0, 0], -90).scale(4)),
        "light": light,
    }
    if sky:
        world["sky"] = {"type": "constant", "radiance": sky}
    return mi.load_dict({"type": "scene"} | with_film(world, {"width": size, "height": size}))


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--only", default="", help="part of a row's name")
    options = parser.parse_args()
    begin(options)
    rows = {
        name: [scene(options.size, look, lamp([2, 4, 2], 0.5, 20.0), 0.3) for look in pair]
        for name, pair in MATERIALS.items()
    }
    rows |= {name: [scene(options.size, diffuse(0.5), light, 0) for light in pair] for name, pair in LIGHTS.items()}
    rows = {name: pair for name, pair in rows.items() if options.only in name}
    print("| | time | variance |\n|---|---:|---:|")
    for name, scenes in rows.items():
        pair = [Run("", one, {"type": "path", "max_depth": 6}, 32) for one in scenes]
        images = renders(pair, options.rounds)

        def quotients(k: np.ndarray) -> np.ndarray:
            """Returns the ratios of times and of variances for the rounds with the indices ``k``."""
            seconds = [np.median(np.array(run.seconds)[k]) for run in pair]  # noqa: B023  (used at once)
            noise = [np.array(of)[k].var(axis=0).mean() / np.mean(of) ** 2 for of in images]  # noqa: B023
            return np.array([seconds[0] / seconds[1], noise[0] / max(noise[1], 1e-12)])

        print(f"| {name} | " + " | ".join(map(shown, interval(quotients, options.rounds, 200).T)) + " |", flush=True)


if __name__ == "__main__":
    main()
