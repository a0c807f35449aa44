"""Renders the example scenes for the thesis's figures."""

from pathlib import Path

import mitsuba as mi
import numpy as np
import prosim_scene
from mitsuba_prosim.scene.images import compress

SCENES = Path(__file__).parents[1]


def load(name, factor=1, samples=None, **integrator):
    """The dictionary of a scene. ``factor`` scales its resolution; ``integrator`` has further parameters of the
    integrator.
    """
    path = SCENES / f"{name}.scn"
    view = prosim_scene.parse(prosim_scene.read(path), path).view
    size = tuple(max(1, round(factor * x)) for x in view.resolution)
    description = prosim_scene.load(path, resolution=size, samples=samples)
    description["integrator"] |= integrator
    return description


def render(name, factor, samples=None, **integrator):
    """The linear image of a scene, (height, width, 3), with highlights compressed as ``prosim render`` does."""
    return compress(np.array(mi.render(mi.load_dict(load(name, factor, samples, **integrator)))))


def render_counts(name, factor, samples=None):
    """The number of samples of each pixel, as grey; the largest number is white."""
    description = load(name, factor, samples, aovs="samples")
    counts = np.array(mi.render(mi.load_dict(description)))[..., 3:]
    return np.repeat(counts / counts.max(), 3, axis=2)


def render_path(name, factor, spp):
    """The image of a scene by Mitsuba's path tracer, in which the background is an emitter and no ambient term
    exists.
    """
    description = load(name, factor)
    background = description["integrator"]["background"]
    description["integrator"] = {
        "type": "path",
        "max_depth": description["integrator"]["max_level"] + 2,
        "hide_emitters": True,
    }
    description["background"] = {"type": "constant", "radiance": background}
    scene = mi.load_dict(description)
    image, done = 0, 0
    while done < spp:  # renders in parts, which need less memory
        part = min(64, spp - done)
        image = image + part * np.array(mi.render(scene, spp=part, seed=done))
        done += part
    return image / spp
