"""Tests of an integrator: images of small scenes against those of volpath."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mitsuba as mi
import numpy as np

from ..report import NOTE, OK, Report
from ..statistics import welch
from ..subject import Subject

#: Images of each scene, with other seeds; pixels per side; blocks per side; samples per pixel.
IMAGES, SIDE, BLOCKS, SAMPLES = 32, 12, 3, 16

#: Variance above that of the reference that is reported.
FACTOR = 4


def scenes() -> Iterator[tuple[str, dict[str, Any]]]:
    """Yields the name and the dictionary of scenes in which a floor is lit directly: materials and lamps cross."""
    above = mi.ScalarTransform4f().translate([0.3, 0.2, 1.2]).rotate([1, 0, 0], 180).scale(0.3)
    view = mi.ScalarTransform4f().look_at([0, 0.5, 2], [0, 0, 0], [1, 0, 0])
    lamps = {
        "rectangle": {"type": "rectangle", "to_world": above, "emitter": {"type": "area"}},
        "sphere": {"type": "sphere", "center": [0.3, 0.2, 1.2], "radius": 0.2, "emitter": {"type": "area"}},
        "point": {"type": "point", "position": [0.3, 0.2, 1.2]},
        "spot": {"type": "spot", "to_world": view, "cutoff_angle": 30.0},
        "constant": {"type": "constant"},
    }
    materials = {
        "diffuse": {"type": "diffuse", "reflectance": {"type": "checkerboard"}},
        "rough metal": {"type": "roughconductor", "alpha": 0.3},
        "plastic": {"type": "roughplastic", "alpha": 0.2},
        "mask": {"type": "mask", "opacity": 0.6, "nested": {"type": "diffuse"}},
    }
    for i, (lamp, emitter) in enumerate(lamps.items()):
        for material, bsdf in [*materials.items()][i % 2 :: 2]:
            yield f"{material}, {lamp}", {"lamp": emitter, "floor": {"type": "rectangle", "bsdf": bsdf}}


def images(integrator: Any, things: dict[str, Any]) -> np.ndarray:
    """Means of blocks of independent images, shape (images, blocks)."""
    film = {"type": "hdrfilm", "width": SIDE, "height": SIDE, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    view = mi.ScalarTransform4f().look_at([0, -2.5, 2], [0, 0, 0], [0, 0, 1])
    sensor = {"type": "perspective", "fov": 35, "to_world": view, "film": film, "sampler": {"type": "independent"}}
    scene, size = mi.load_dict({"type": "scene", "sensor": sensor, **things}), SIDE // BLOCKS
    found = [np.array(mi.render(scene, integrator=integrator, spp=SAMPLES, seed=7 + i))[..., :3] for i in range(IMAGES)]
    return np.array(found).reshape(IMAGES, BLOCKS, size, BLOCKS, size, 3).mean(axis=(2, 4, 5)).reshape(IMAGES, -1)


def test_images(subject: Subject, report: Report) -> None:
    """Blocks of images have the means of the reference, and at most four times its variance."""
    for name, things in scenes():
        a, b = images(subject.load(), things), images(mi.load_dict({"type": "volpath"}), things)
        report.require("pixels are finite", np.isfinite(a), name)
        for i in range(BLOCKS**2):
            report.add("blocks have the light of volpath", where=f"{name}, block {i}", **welch(a[:, i], b[:, i]))
        report.add("images have the light of volpath", where=name, **welch(a.sum(axis=1), b.sum(axis=1)))
        factor = float(a.var(axis=0).mean() / max(b.var(axis=0).mean(), 1e-12 + 1e-6 * b.mean() ** 2))
        verdict = NOTE if factor > FACTOR else OK
        report.add("variance is at most 4 times that of volpath", verdict, f"{factor:.2f} times", name)


TESTS = (test_images,)
