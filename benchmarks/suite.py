"""The scenes that the engine's promises and its allocation of samples are measured on, and their converged images.

Ours come from ``examples/``, rendered as they say; the others' are the Cornell box and ``caustica`` by Mitsuba's
``path`` within ``prosim_adaptive``, and a ball of rough gold beside one of glass by every path.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import prosim_scene
from mitsuba_prosim import atomic
from mitsuba_prosim.compare import runs
from scenes import ball, copper, cornell_box, stage

EXAMPLES = Path(__file__).parents[1] / "examples"
OURS = (
    "palito",
    "aranha",
    "chao-rugoso",
    "penumbra",
    "fontes",
    "esfera-metalica",
    "poste",
    "chimarrao",
    "cone",
    "spot",
)
#: By :func:`nested`.
OTHERS = ("cornell", "caustica", "gold")
NAMES = OURS[:3] + OTHERS + OURS[3:]


def nested(depth: int) -> dict[str, Any]:
    """``path`` within ``prosim_adaptive``."""
    return {"type": "prosim_adaptive", "nested": {"type": "path", "max_depth": depth}}


def description(name: str, size: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """``(scene, integrator)`` as dictionaries, ``size`` pixels wide and high."""
    if name in OURS or name == "caustica":
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scene = prosim_scene.load(EXAMPLES / f"{name}.scn", resolution=(size, size))
        integrator = scene.pop("integrator")
        return scene, nested(8) if name == "caustica" else integrator
    film = {"type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgb", "rfilter": {"type": "box"}}
    if name == "cornell":
        scene, integrator = cornell_box(), nested(8)
    else:
        gold = copper(0.15) | {"material": "Au"}
        glass = {"type": "dielectric", "int_ior": 1.5}
        scene = stage(gold=ball([-0.6, 0.8, 0], 0.8, gold), glass=ball([1.1, 0.7, 0.5], 0.7, glass))
        integrator = {"type": "prosim", "diffuse_bounces": -1, "max_level": 8}
    scene["sensor"] = scene["sensor"] | {"film": film}
    return {"type": "scene"} | scene, integrator


@dataclass
class Reference:
    """The mean of two converged images, linear, shape (height, width, 3), whose difference says how noisy it is."""

    first: np.ndarray
    second: np.ndarray

    @property
    def image(self) -> np.ndarray:
        """The best that is known."""
        return (self.first + self.second) / 2


class Subject:
    """A scene of :data:`NAMES`, loaded."""

    def __init__(self, name: str, size: int) -> None:
        self.name, self.size = name, size
        scene, self.settings = description(name, size)
        self.scene = mi.load_dict(scene)
        self.key = f"suite {scene} {self.settings} {mi.variant()} {mi.__version__}"

    def integrator(self, **parameters: Any) -> mi.Integrator:
        """The scene's integrator with other parameters."""
        return mi.load_dict(self.settings | parameters)

    def render(self, integrator: mi.Integrator, seed: int) -> np.ndarray:
        """The image, linear, with the integrator's own channels after r, g and b."""
        image = integrator.render(self.scene, self.scene.sensors()[0], seed=seed)
        return np.array(image, dtype=np.float64)

    def reference(self, folder: Path, seconds: float) -> Reference:
        """Two images of so many seconds together, kept in ``folder``."""
        path = Path(folder) / f"{hashlib.sha256(f'{self.key} {seconds}'.encode()).hexdigest()[:20]}.npz"
        if path.exists():
            with np.load(path) as kept:
                return Reference(kept["first"], kept["second"])
        integrator = self.integrator(adaptive="none", samples=16)
        halves, count, begun = [0.0, 0.0], 0, time.process_time()
        while count < 2 or time.process_time() - begun < seconds:
            for k in range(2):
                halves[k] = halves[k] + self.render(integrator, runs.REFERENCE_SEEDS + 2 * count + k)[..., :3]
            count += 1
        halves = [half / count for half in halves]
        content = io.BytesIO()
        np.savez(content, first=halves[0], second=halves[1])
        atomic.write({path: content.getvalue()})
        return Reference(*halves)


def luminance(image: np.ndarray) -> np.ndarray:
    """Luminance of linear r, g and b."""
    return image[..., :3] @ np.array([0.212671, 0.715160, 0.072169])


def arguments(description: str | None, size: int) -> argparse.ArgumentParser:
    """A parser of what all benchmarks of the suite may be told; ``size``: the default of it."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=size, help="width and height in pixels")
    parser.add_argument("--reference-seconds", type=float, default=60)
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--cache", type=Path, default=runs.cache_folder())
    return parser


def begin(variant: str, threads: int) -> None:
    """Sets Mitsuba up; ``threads`` 0: as many as there are cores."""
    mi.set_variant(variant)
    import mitsuba_prosim  # noqa: F401  (registers the plugins)

    mi.set_log_level(mi.LogLevel.Error)
    if threads:
        dr.set_thread_count(threads)
