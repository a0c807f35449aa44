"""Two scenes rendered turn by turn, so that a drift of the machine's speed falls on both."""

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
