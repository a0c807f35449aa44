"""Draws the figures of sections 4.2 and 5.3: sampling strategies, strata, and the renderer's N-rook patterns."""

import drjit as dr
import mitsuba as mi
import numpy as np
from mitsuba_prosim.sampling.nrook import NRook, Permutations, pixel_key

from . import patterns


def square(figure, place, strata=0, title=None):
    """Axes of the unit square at ``place`` in the figure, with a grid of strata."""
    axes = figure.add_subplot(*place, xlim=(0, 1), ylim=(0, 1), aspect="equal", xticks=[], yticks=[], title=title)
    for x in np.arange(1, strata) / max(strata, 1):
        axes.axhline(x, color="0.8", lw=0.8, zorder=0)
        axes.axvline(x, color="0.8", lw=0.8, zorder=0)
    return axes


def numbered(axes, points, color="C0"):
    """Draws the numbers of points at their positions."""
    for i, (x, y) in enumerate(np.clip(points, 0.04, 0.96)):  # keeps the numbers inside the frame
        axes.text(x, y, str(i + 1), color=color, ha="center", va="center", weight="bold")


def strategy(figure, name, n, strata=0):
    """Draws n samples of the sampling strategy ``name``."""
    axes = square(figure, (1, 1, 1), strata)
    axes.plot(*getattr(patterns, name)(n, np.random.default_rng(1992)).T, "o", ms=4, color="C0")
    return axes


def jittering(figure):
    """Draws 16 jittered samples and the centres of their cells (figure 4.4)."""
    axes = strategy(figure, "jittered", 16, 4)
    axes.plot(*patterns.regular(16, None).T, "+", color="0.4", zorder=0)
    axes.set_xlabel("+ regular   ● jittered")


def equal_regions(axes, x, density, regions):
    """Draws a density, divided into ``regions`` of equal area; returns the borders of the regions."""
    cumulative = np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) * np.diff(x) / 2)])
    edges = np.interp(np.linspace(0, cumulative[-1], regions + 1), cumulative, x)
    axes.plot(x, density, "k-")
    for i in range(regions):
        inside = (x >= edges[i]) & (x <= edges[i + 1])
        axes.fill_between(x[inside], density[inside], color=f"C{i}", alpha=0.35)
    axes.set(xticks=edges, xticklabels=[""] * len(edges), yticks=[], xlim=(x[0], x[-1]), ylim=(0, 1.1 * density.max()))
    return edges


def importance(figure):
    """Draws importance sampling: one random sample in each of eight regions of equal probability (figure 4.5)."""
    axes = figure.add_subplot(xlabel="X", ylabel="P(X)")
    x = np.linspace(0, 1, 2001)
    edges = equal_regions(
        axes, x, 0.15 + np.exp(-(((x - 0.42) / 0.13) ** 2)) + 0.3 * np.exp(-(((x - 0.8) / 0.1) ** 2)), 8
    )
    u = np.random.default_rng(4).random(8)
    axes.plot(edges[:-1] + u * np.diff(edges), np.zeros(8), "ko", clip_on=False, zorder=3)


def source_strata(figure):
    """Strata of equal probability of the angle theta from a source's centre, with the density P(theta) = 2 pi k
    sin(theta).

    The largest theta is the angle under which the radius of the source is seen.
    """
    axes = figure.add_subplot(xlabel="θ, from the middle of the source to its rim", ylabel="P(θ) ∝ sin θ")
    theta = np.linspace(0, 0.3, 2001)
    equal_regions(axes, theta, np.sin(theta), 5)


def uncorrelated(figure):
    """Draws the numbers of uncorrelated jittered samples in two spaces (figure 4.6)."""
    rng = np.random.default_rng(6)
    for i, name in enumerate(("pixel", "direction of reflection")):
        numbered(square(figure, (1, 2, i + 1), 3, name), patterns.uncorrelated_jittered(9, rng))


def nrook_points(n, r, space, pixel=0):
    """The samples of pass ``r`` of the renderer in one space, in their order: shape (n, 2)."""
    sample = NRook(Permutations(n), pixel_key(7, pixel), r * n + dr.arange(mi.UInt32, n), "uniform")
    return np.array(sample(space)).T


def association(figure):
    """Draws the numbers of the renderer's samples in two spaces: pixel and source (figure 5.10)."""
    for space, name in enumerate(("pixel", "source")):
        numbered(square(figure, (1, 2, space + 1), 5, name), nrook_points(5, 0, space))


def rotation(figure):
    """Draws the samples of one, two and three passes of the renderer for N = 3 (figure 5.11)."""
    n = 3
    for last in range(n):
        axes = square(figure, (1, n, last + 1), n, f"{n * (last + 1)} samples")
        for r in range(last + 1):
            numbered(axes, nrook_points(n, r, 0), f"C{r}")


def four_rays(figure):
    """Four rays through a pixel in a plane; each has a stratum of the pixel, of the source and of the reflected
    lobe.
    """
    from matplotlib.patches import Circle

    rng = np.random.default_rng(11)
    axes = figure.add_subplot(aspect="equal", xlim=(-0.6, 10.2), ylim=(-0.6, 6.4))
    axes.axis("off")
    eye, ball, radius, lamp, size = np.array([0, 4.4]), np.array([8.5, 2.6]), 1.3, np.array([5.0, 5.5]), 0.7
    for center, r, color in ((ball, radius, "0.85"), (lamp, size, "#fd6")):
        axes.add_patch(Circle(center, r, facecolor=color, edgecolor="0.4"))
    axes.plot([-0.4, 10], [0, 0], "-", color="0.4", lw=3)
    axes.plot([1.6, 1.6], [2.9, 3.3], "-", color="0.4", lw=3)
    axes.plot(*eye, "ko")
    for (x, y), name in (
        ((-0.3, 4.7), "eye"),
        ((0.75, 2.75), "pixel"),
        ((5.95, 5.5), "source"),
        ((1.6, -0.45), "rough floor"),
    ):
        axes.text(x, y, name)
    pixel, source, lobe = ((rng.permutation(4) + rng.random(4)) / 4 for _ in range(3))
    for i in range(4):
        d = np.array([1.6, 2.9 + 0.4 * pixel[i]]) - eye
        hit = eye - d * eye[1] / d[1]
        angle = np.arctan2(-d[1], d[0]) + 0.5 * (lobe[i] - 0.5)  # the angle of the reflected ray
        out = np.array([np.cos(angle), np.sin(angle)])
        b = np.dot(ball - hit, out)
        inside = radius**2 - np.sum((ball - hit) ** 2) + b**2
        end = hit + out * (b - np.sqrt(inside) if inside > 0 else 5)
        across = np.array([lamp[1], hit[0] - lamp[0]]) / np.hypot(lamp[1], hit[0] - lamp[0])
        axes.plot(*np.stack([eye, hit, end]).T, "-", color=f"C{i}", lw=1)
        axes.plot(*np.stack([hit, lamp + across * size * (2 * source[i] - 1)]).T, ":", color=f"C{i}", lw=1.2)
