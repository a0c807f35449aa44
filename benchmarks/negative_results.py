"""Negative results: the gains of other sampling rules, simulated with the same integrator.

    python benchmarks/negative_results.py allocation frozen [--scene palito ...]

``thesis``
    The thesis's own criterion, which decides by the samples of a pixel whether the pixel needs more samples. The table
    shows the gain in processor time over uniform sampling with N = 8, at the same mean number of samples.
``photons``
    The gain in processor time of ``graded`` over uniform sampling in a scene whose caustics come from photons. New
    photons cost as much for one pixel as for all pixels.
``allocation``
    The gains over uniform sampling in passes of 16 samples, all with a mean of 64 and a maximum of 256 samples:
    ``graded``; ``cycles``, the stopping rule of Mitsuba's pull request 1731, which is the rule of Blender's Cycles;
    ``oracle``, samples in proportion to the true standard deviation of each pixel, which is estimated with other seeds.
``frozen``
    The fraction of the variance that remains if all samples of a pixel share one direction of the first surface's
    lobe, or one point on the lamps.
``gradients``
    Gradient-domain rendering (Kettunen et al. 2015): differences of adjacent pixels are rendered with the same random
    numbers, and the image is the solution of a Poisson equation. The gain over uniform sampling counts all three
    renders.

A cell is the gain in samples for the tone-mapped error (``thesis`` and ``photons``: the gain in time; ``frozen``: a
ratio of variances), with its 95 % interval over the seeds.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from typing import Any
from unittest import mock

import drjit as dr
import mitsuba as mi
import numpy as np
from gains import NESTED, PATHS, with_samples
from measure import MEASURES, Run, arguments, begin, gain, interval, reference, render_in_turn, shown
from mitsuba_prosim.engine.plan import Plan
from mitsuba_prosim.light.table import Lights
from mitsuba_prosim.sampling.sobol import Sobol
from mitsuba_prosim.transport.transport_context import CAMERA_SPACES, DIFFUSE, NODE_SPACES, REFLECTED
from scipy.fft import dctn, idctn
from scipy.ndimage import maximum_filter
from subjects import Subject

#: The maximum number of passes of a pixel; the mean number is a quarter of it.
PASSES = 16


def tone_mapped(image: np.ndarray, truth: np.ndarray) -> float:
    """Returns the mean squared error after a square root."""
    return MEASURES["tone-mapped"](image, truth)


def over_uniform(
    name: str, adaptive: dict[str, Any], subject: Subject, options: argparse.Namespace, n: int = 8
) -> dict[str, np.ndarray]:
    """Returns the gain in time of ``adaptive``, parameters of an integrator: value and interval, shape (3,)."""
    scene, tree = subject.load(), (subject.tree or NESTED) | adaptive
    uniform = Run("none", scene, tree | {"adaptive": "none", "samples": n})
    found = with_samples(Run(name, scene, tree | {"max_samples": 4 * n * n}), n * n)
    truth = reference(subject, uniform.integrator, 0, options.reference_seconds, options.cache)
    render_in_turn([found, uniform], truth, options.rounds, ["tone-mapped"])
    return {name: gain(found, uniform)[:, 0]}


def cycles(means: np.ndarray, images: np.ndarray) -> np.ndarray:
    """Returns the number of passes of each pixel by the stopping rule of Cycles.

    I is the mean of a pixel, and E is the mean of every other pass. A pixel stops when ``|I - E| / sqrt(I)``, summed
    over the colours, is below a threshold for the pixel and its neighbours.
    """
    even = np.cumsum(images[::2], axis=0) / np.arange(1, PASSES // 2 + 1)[:, None, None, None]
    noise = np.abs(means[1::2] - even).sum(axis=-1) / (1e-4 + np.sqrt(means[1::2].sum(axis=-1)))

    def stopped(threshold: float) -> np.ndarray:
        active = np.ones(noise.shape[1:], bool)
        last = np.zeros(active.shape, int)
        for k in range(len(noise)):
            last[active] = k
            active &= maximum_filter(noise[k] > threshold, 3)
        return 2 * (last + 1)

    return min((stopped(t) for t in np.geomspace(1e-4, 1, 60)), key=lambda passes: abs(passes.mean() - PASSES / 4))


def oracle(deviation: np.ndarray) -> np.ndarray:
    """Returns the number of passes of each pixel, in proportion to the pixel's true standard deviation."""
    candidates = [np.clip(np.rint(deviation * scale), 1, PASSES).astype(int) for scale in np.geomspace(1, 1e5, 300)]
    return min(candidates, key=lambda passes: abs(passes.mean() - PASSES / 4))


def allocation(subject: Subject, options: argparse.Namespace, n: int = 4) -> dict[str, np.ndarray]:
    """Returns the gains of ``graded`` and the two rules over passes of n² samples: value and interval, shape (3,)."""
    tree = (subject.tree or NESTED) | {"adaptive": "none", "samples": n}
    truth = reference(subject, tree, 0, options.reference_seconds, options.cache)
    run, scale = Run("", subject.load(), tree), 0.25 / truth.mean()
    graded = tree | {"adaptive": "graded", "samples": 2 * n, "max_samples": PASSES * n * n}
    ours = with_samples(Run("", run.scene, graded), PASSES / 4 * n * n)
    images = np.array([run.render(k)[0] for k in range(options.rounds * PASSES)]) * scale
    images = images.reshape(options.rounds, PASSES, *images.shape[1:])
    costs: dict[str, list[list[float]]] = {"graded": [], "cycles": [], "oracle": []}
    for seed, of_seed in enumerate(images):
        means = np.cumsum(of_seed, axis=0) / np.arange(1, PASSES + 1)[:, None, None, None]
        others = np.delete(images, seed, axis=0)
        variance = others.var(axis=(0, 1)) / (4 * np.maximum(others.mean(axis=(0, 1)), 1e-3))
        rows, columns = np.indices(truth.shape[:2])
        uniform = tone_mapped(means[PASSES // 4 - 1], truth * scale) * (PASSES // 4)
        for name, passes in (("cycles", cycles(means, of_seed)), ("oracle", oracle(np.sqrt(variance.sum(axis=-1))))):
            image = means[passes - 1, rows, columns]
            costs[name].append([tone_mapped(image, truth * scale) * passes.mean(), uniform])
        image = ours.render(seed)[0] * scale
        costs["graded"].append([tone_mapped(image, truth * scale) * ours.samples().mean() / n**2, uniform])
    return {name: ratio(np.array(of_rule)) for name, of_rule in costs.items()}


def ratio(errors: np.ndarray) -> np.ndarray:
    """Returns the mean of the second column over the mean of the first: value and interval over the rows, shape
    (3,).
    """
    return interval(lambda k: np.array(errors[k, 1].mean() / errors[k, 0].mean()), len(errors))


class Frozen(Sobol):
    """Sobol' points that, in some ``spaces``, are the same for all samples."""

    spaces: list[int]
    value: mi.Point2f

    def __call__(self, space: int | mi.UInt32, active: mi.Bool = True) -> mi.Point2f:
        point = super().__call__(space, active)
        for frozen in self.spaces:
            point = dr.select(mi.UInt32(space) == frozen, self.value, point)
        return point


def points_of(change: Callable) -> AbstractContextManager:
    """Returns a context in which ``change(points, plan, x, y, t)`` makes the sample points.

    ``points`` is the method of the plan that makes the points outside of the context.
    """
    points = Plan.points
    return mock.patch.object(Plan, "points", lambda plan, x, y, t: change(points, plan, x, y, t))


def frozen(subject: Subject, options: argparse.Namespace, samples: int = 64) -> dict[str, np.ndarray]:
    """Returns the fractions of the variance that remain: value and interval, shape (3,)."""
    scene, tree = subject.load(), (subject.tree or PATHS) | {"adaptive": "none"}
    count, rng = Lights(scene, choose=subject.tree is None).count, np.random.default_rng(1)
    first = CAMERA_SPACES + NODE_SPACES + count
    run, found = Run("", scene, tree, samples), {}

    def variance(spaces: list[int], value: list[float]) -> float:
        point = mi.Point2f(*(dr.opaque(mi.Float, v) for v in value))

        def change(points: Callable, plan: Plan, x: mi.Int32, y: mi.Int32, t: mi.UInt32) -> Sobol:
            result = points(plan, x, y, t)
            result.__class__, result.spaces, result.value = Frozen, spaces, point
            return result

        with points_of(change):
            images = [np.sqrt(np.maximum(run.render(seed)[0], 0)) for seed in rng.integers(0, 1 << 30, 2)]
        return float(np.mean(np.square(images[0] - images[1])))

    lobes, lamps = range(REFLECTED, DIFFUSE + 1), range(NODE_SPACES, NODE_SPACES + count)
    for name, spaces in (("lobe", lobes), ("lamp", lamps)):
        values = rng.random((options.rounds, 2)).tolist()
        pairs = [[variance([], value), variance([first + k for k in spaces], value)] for value in values]
        found[f"{name} frozen"] = ratio(np.array(pairs))
    return found


def gradients(subject: Subject, options: argparse.Namespace, samples: int = 64) -> dict[str, np.ndarray]:
    """Returns the gain of gradient-domain rendering: value and interval, shape (3,)."""
    integrator = (subject.tree or PATHS) | {"adaptive": "none"}
    truth = reference(subject, integrator, 256, options.reference_seconds, options.cache)
    run, scale = Run("", subject.load(), integrator, samples), 0.25 / truth.mean()
    errors = []
    for seed in range(options.rounds):
        images = []
        for dx, dy in ((0, 0), (1, 0), (0, 1)):
            # The pixel (x, y) has the random numbers of the pixel (x - dx, y - dy).
            with points_of(lambda points, plan, x, y, t, dx=dx, dy=dy: points(plan, x - dx, y - dy, t)):
                images.append(run.render(seed)[0] * scale)
        base, right, below = images
        solution = poisson(sum(images) / 3, right[:, 1:] - base[:, :-1], below[1:] - base[:-1])
        errors.append([3 * tone_mapped(np.maximum(solution, 0), truth * scale), tone_mapped(base, truth * scale)])
    return {"gradients": ratio(np.array(errors))}


def poisson(image: np.ndarray, dx: np.ndarray, dy: np.ndarray, weight: float = 0.2) -> np.ndarray:
    """Returns the least-squares image for the differences ``dx`` and ``dy`` between adjacent pixels, and for ``image``.

    ``image`` has shape (height, width, 3); its squared differences have the factor ``weight`` squared.
    """
    height, width = image.shape[:2]
    right = weight**2 * image
    right[:, 1:] += dx
    right[:, :-1] -= dx
    right[1:] += dy
    right[:-1] -= dy
    waves = [2 - 2 * np.cos(np.pi * np.arange(size) / size) for size in (height, width)]
    operator = weight**2 + waves[0][:, None, None] + waves[1][None, :, None]
    return idctn(dctn(right, axes=(0, 1), norm="ortho") / operator, axes=(0, 1), norm="ortho")


TABLES: dict[str, Callable[..., dict[str, np.ndarray]]] = {
    "thesis": partial(over_uniform, "thesis", {"adaptive": "thesis", "samples": 13}),
    "photons": partial(over_uniform, "photons", {"adaptive": "graded", "caustics": True, "samples": 8}),
    "allocation": allocation,
    "frozen": frozen,
    "gradients": gradients,
}


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("table", nargs="+", choices=TABLES)
    options = parser.parse_args()
    begin(options)
    print("| | | (95 %) |\n|---|---|---:|")
    for name in options.scene:
        subject = Subject(name, options.size, options.folder)
        for table in options.table:
            for row, value in TABLES[table](subject, options).items():
                print(f"| {name} | {row} | {shown(value)} |", flush=True)


if __name__ == "__main__":
    main()
