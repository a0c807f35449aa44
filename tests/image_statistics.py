"""Statistical comparison of renderings, and what a failed test of images leaves behind."""

import os
import re
from pathlib import Path

import mitsuba as mi
import numpy as np
import OpenEXR
import scipy
from scenes import T, film, rectangle

FOLDER = Path(__file__).parents[1] / "build" / "failed-images"


def leave(note, **images):
    """Writes images (height, width, channels) as EXR, and a note; the folder, named after the test."""
    test = os.environ.get("PYTEST_CURRENT_TEST", "a test (call)").rpartition(" ")[0]
    folder = FOLDER / re.sub(r"[^\w.-]+", "-", test.rpartition("/")[2]).strip("-")
    folder.mkdir(parents=True, exist_ok=True)
    for name, image in images.items():
        image = np.asarray(image, np.float32)
        planes = image.transpose(2, 0, 1)[: 3 if image.shape[2] >= 3 else 1]
        channels = {channel: np.ascontiguousarray(plane) for channel, plane in zip("RGB", planes)}
        OpenEXR.File({}, channels).write(str(folder / f"{name}.exr"))
    (folder / "note.txt").write_text(note + "\n", encoding="utf-8")
    return folder


def renderings(scene, count, spp=0, first_seed=0, **integrator):
    """``count`` independent images of the dict ``scene``, an array (count, height, width, channels)."""
    if integrator:
        scene = {**scene, "integrator": integrator}
    loaded = mi.load_dict(scene)
    return np.stack([np.array(mi.render(loaded, seed=first_seed + k, spp=spp)) for k in range(count)]).astype(float)


def cards(bsdfs, side, lamps, turn=0, **how):
    """R, G, B and alpha of the pixels of cards in one plane, which send no light to one another: (cards, pixels, 4).
    Each card is turned by ``turn`` degrees, and ``side`` pixels wide; where a BSDF is None, there is no card.
    """
    n = len(bsdfs)
    to_world = T().look_at([n, 0, 5], [n, 0, 0], [0, 1, 0]).scale([n, n, 1])
    pixels = film(side * n, side, pixel_format="rgba", component_format="float32")
    scene = {"type": "scene", "sensor": {"type": "orthographic", "to_world": to_world, "film": pixels}, **lamps}
    for k, bsdf in enumerate(bsdfs):
        if bsdf is not None:
            scene[f"card {k}"] = rectangle(T().translate([2 * k + 1, 0, 0]).rotate([0, 1, 0], turn), bsdf=bsdf)
    image = renderings(scene, 1, **how)[0]
    return image.reshape(side, n, side, 4).transpose(1, 0, 2, 3).reshape(n, -1, 4)


def blocks(images, size=8):
    """Means over squares of ``size`` by ``size`` pixels: (count, rows, columns, channels)."""
    n, h, w, c = images.shape
    return images.reshape(n, h // size, size, w // size, size, c).mean((2, 4))


def p_values(a, b, relative=1e-5):
    """How probable differences as large as those between two sets of images are by chance, block by block.

    Welch's t-test on the means of blocks of pixels: (rows, columns, channels). Differences below ``relative`` times the
    mean of the image are rounding, and no difference.
    """
    a, b = blocks(a), blocks(b)
    difference = a.mean(0) - b.mean(0)
    va, vb = a.var(0, ddof=1) / len(a), b.var(0, ddof=1) / len(b)
    rounding = relative * np.abs(a).mean()
    z = np.maximum(np.abs(difference) - rounding, 0) / np.sqrt(va + vb + 1e-30)
    freedom = (va + vb) ** 2 / (va**2 / (len(a) - 1) + vb**2 / (len(b) - 1) + 1e-60)
    return 2 * scipy.special.stdtr(np.maximum(freedom, 1), -z)


def same_expectation(reference, images, significance=0.01, relative=1e-5):
    """True if two sets of independent images may have the same expectation.

    ``significance``: that of the whole image (Šidák's correction for the number of blocks). Raises AssertionError if
    they may not; it names a folder with both means, their difference, and the probabilities (see :func:`p_values`).
    """
    p = p_values(reference, images, relative)
    least = 1 - (1 - significance) ** (1 / p.size)
    if p.min() > least:
        return True
    row, column, channel = np.unravel_index(p.argmin(), p.shape)
    pair = [blocks(x)[:, row, column, channel].mean() for x in (images, reference)]
    note = (
        f"p = {p.min():.2g} in the block of pixels {8 * column}..{8 * column + 7}, {8 * row}..{8 * row + 7}, channel "
        f"{channel}: {pair[0]:.6g}, the reference {pair[1]:.6g}. By chance one image in {1 / significance:.0f} has a "
        f"p below {least:.2g}; here {np.sum(p <= least)} of {p.size} blocks have."
    )
    image, mean = images.mean(0), reference.mean(0)
    table = np.array2string(p.min(axis=2), precision=1, max_line_width=10**6, threshold=10**6)
    folder = leave(f"{note}\n\np, block by block:\n{table}", image=image, reference=mean, difference=image - mean)
    raise AssertionError(f"the two have different expectations: {note}. See {folder}")
