"""Statistical comparison of renderings."""

import mitsuba as mi
import numpy as np
from scipy import stats


def renderings(scene, count, spp=0, first_seed=0, **integrator):
    """``count`` independent images of the dict ``scene``, an array (count, height, width, channels)."""
    if integrator:
        scene = {**scene, "integrator": integrator}
    loaded = mi.load_dict(scene)
    return np.stack([np.array(mi.render(loaded, seed=first_seed + k, spp=spp)) for k in range(count)]).astype(float)


def blocks(images, size=8):
    """Means over squares of ``size`` by ``size`` pixels: (count, rows, columns, channels)."""
    n, h, w, c = images.shape
    return images.reshape(n, h // size, size, w // size, size, c).mean((2, 4))


def same_expectation(a, b, significance=0.01, relative=1e-5):
    """Whether two sets of independent images may have the same expectation.

    Welch's t-test on the means of blocks of pixels, at the given significance for the whole image (Šidák's correction
    for the number of blocks); differences below ``relative`` are rounding.
    """
    a, b = blocks(a), blocks(b)
    difference = a.mean(0) - b.mean(0)
    va, vb = a.var(0, ddof=1) / len(a), b.var(0, ddof=1) / len(b)
    rounding = relative * np.abs(a).mean()
    z = np.maximum(np.abs(difference) - rounding, 0) / np.sqrt(va + vb + 1e-30)
    freedom = (va + vb) ** 2 / (va ** 2 / (len(a) - 1) + vb ** 2 / (len(b) - 1) + 1e-60)
    p = 2 * stats.t.sf(z, np.maximum(freedom, 1))
    return p.min() > 1 - (1 - significance) ** (1 / p.size)
