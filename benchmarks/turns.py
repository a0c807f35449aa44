"""Two scenes rendered turn by turn, so that a drift of the machine's speed falls on both; and the one both vary."""

import argparse
import time

import drjit as dr
import mitsuba as mi
import numpy as np


def render(scene, seed):
    """``(seconds, image)`` of one rendering."""
    start = time.perf_counter()
    image = mi.render(scene, seed=seed)
    dr.eval(image)
    dr.sync_thread()
    return time.perf_counter() - start, np.array(image)


def compare(ours, theirs, rounds):
    """(median seconds of ours, time quotient, variance quotient) of two scenes; the quotients are ours / theirs."""
    times, images = np.empty((rounds, 2)), [[], []]
    for turn in range(-1, rounds):  # turn -1 warms up
        for i in (0, 1) if turn % 2 else (1, 0):
            times[turn, i], image = render((ours, theirs)[i], turn + 1)
            images[i] += [image] if turn >= 0 else []
    variances = [np.var(x, axis=0, ddof=1).mean() / np.mean(x) ** 2 for x in images]
    return np.median(times[:, 0]), np.median(times[:, 0] / times[:, 1]), variances[0] / variances[1]


def arguments(description):
    """A parser with the options of every benchmark that goes by turns."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--size", type=int, default=192)
    parser.add_argument("--spp", type=int, default=32)
    parser.add_argument("--rounds", type=int, default=9)
    return parser


def ball_on_a_floor(size, spp, max_depth, look, others):
    """A scene: ball and floor with the entries ``look``, and ``others`` beside them."""
    place = mi.ScalarTransform4f
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": max_depth},
            "sensor": {
                "type": "perspective",
                "fov": 35,
                "to_world": place().look_at([0, 3, 6], [0, 0.8, 0], [0, 1, 0]),
                "sampler": {"type": "independent", "sample_count": spp},
                "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
            },
            **others,
            "ball": {"type": "sphere", "center": [0, 1, 0], **look},
            "floor": {"type": "rectangle", "to_world": place().rotate([1, 0, 0], -90).scale(4), **look},
        }
    )
