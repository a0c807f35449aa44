"""Error against time: log-log curves with fitted slopes, and crops at equal time with maps of errors and samples.

    python benchmarks/convergence.py [--scene penumbra ...] [--size 256] [--rounds 10] [--output FOLDER]

For each scene, the program writes the figure ``NAME.png`` to the folder. It prints a table of the slopes of log RMSE
over log processor seconds, with 95 % intervals. If a tree of rays follows all light of a built scene, ``prosim`` is
compared with ``direct``, otherwise with ``path``.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import mitsuba as mi
import numpy as np
from gains import DEPTH, NESTED, PATHS
from measure import Run, arguments, begin, interval, reference, render_in_turn, tone_mapped_error
from subjects import BUILT, Subject

COUNTS = (2, 3, 5, 9)
SAMPLERS = ("independent", "multijitter", "owen")


def curves(subject: Subject) -> tuple[dict[str, list[Run]], dict, int]:
    """Returns ``(curves, integrator, samples)``.

    ``curves`` maps the name of a curve to runs of growing cost. ``integrator`` and ``samples`` describe the reference.
    """
    direct = subject.name in BUILT and subject.tree
    theirs = {"type": "direct"} if direct else {"type": "path", "max_depth": DEPTH}
    ours = (subject.tree if direct else PATHS) | {"adaptive": "none"}
    scene, found = subject.load(), {}
    found["prosim, N x N"] = [Run("", scene, ours | {"samples": n}) for n in COUNTS]
    # The threshold is proportional to 1 / sqrt(samples), as the error is.
    found["prosim, graded"] = [
        Run("", scene, ours | {"adaptive": "graded", "samples": n, "threshold": 0.05 / n}) for n in COUNTS
    ]
    if not direct:
        found["prosim_adaptive"] = [Run("", scene, NESTED | {"adaptive": "none", "samples": n}) for n in COUNTS]
    for sampler in SAMPLERS:
        scene = subject.load(sampler)
        found[f"{theirs['type']}, {sampler}"] = [Run("", scene, theirs, n * n) for n in COUNTS]
    return found, theirs, 256


def rms(run: Run, k: np.ndarray) -> float:
    """Returns the root mean square of the tone-mapped error of a run over the rounds with the indices ``k``."""
    return np.sqrt(np.array(run.errors)[k, 0].mean())


def slope(curve: list[Run]) -> np.ndarray:
    """Returns the slope of log error over log cost, with its 95 % interval: shape (3,)."""

    def fitted(k: np.ndarray) -> np.ndarray:
        """Returns the slope for the rounds with the indices ``k``."""
        costs = [np.median(np.array(run.seconds)[k]) for run in curve]
        return np.polyfit(np.log(costs), np.log([rms(run, k) for run in curve]), 1)[0]

    return interval(fitted, len(curve[0].seconds))


def draw(
    subject: Subject, found: dict[str, list[Run]], slopes: dict[str, np.ndarray], truth: np.ndarray, path: Path
) -> None:
    """Draws the curves, and below them crops of images that took about as long as the largest ``graded`` run."""
    figure = plt.figure(figsize=(12, 10), layout="constrained")
    upper, lower = figure.subfigures(2, 1, height_ratios=(1, 1.1))
    axes = upper.subplots()
    for name, curve in found.items():
        every = np.arange(len(curve[0].seconds))
        costs, errors = [np.median(run.seconds) for run in curve], [rms(run, every) for run in curve]
        axes.loglog(costs, errors, "o-", label=f"{name} (slope {slopes[name][0]:.2f})")
    axes.set(xlabel="processor seconds", ylabel="tone-mapped RMS error", title=subject.name)
    axes.legend(fontsize=8)
    graded = found["prosim, graded"][-1]
    cost = np.median(graded.seconds)
    shown = {name: min(curve, key=lambda run: abs(np.median(run.seconds) - cost)) for name, curve in found.items()}
    shown = {name: shown[name] for name in ("prosim, graded", *(n for n in shown if n.endswith("independent")))}
    grid, scale = lower.subplots(2, 1 + len(shown) + 1), 0.25 / truth.mean()
    grid[0, 0].imshow(mi.util.convert_to_bitmap(truth * scale))
    grid[0, 0].set_title("reference")
    grid[1, 0].axis("off")
    for column, (name, run) in enumerate(shown.items(), 1):
        assert run.image is not None
        grid[0, column].imshow(mi.util.convert_to_bitmap(run.image * scale))
        grid[0, column].set_title(f"{name}, {np.median(run.seconds):.2f} s", fontsize=8)
        error = tone_mapped_error(run.image * scale, truth * scale)
        grid[1, column].imshow(error, vmax=0.1, cmap="magma")
        grid[1, column].set_title(f"error, RMS {np.sqrt(np.mean(error**2)):.4f}", fontsize=8)
    grid[0, -1].imshow(graded.samples(), cmap="viridis")
    grid[0, -1].set_title("samples of graded")
    grid[1, -1].axis("off")
    for axis in grid.flat:
        axis.set(xticks=[], yticks=[])
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--output", type=Path, default=Path("benchmarks/results"))
    options = parser.parse_args()
    begin(options)
    options.output.mkdir(parents=True, exist_ok=True)
    print("| | | slope (95 %) |\n|---|---|---:|")
    for name in options.scene:
        subject = Subject(name, options.size, options.folder)
        found, integrator, spp = curves(subject)
        truth = reference(subject, integrator, spp, options.reference_seconds, options.cache)
        render_in_turn([run for curve in found.values() for run in curve], truth, options.rounds, ["tone-mapped"])
        slopes = {label: slope(curve) for label, curve in found.items()}
        draw(subject, found, slopes, truth, options.output / f"{name.replace(' ', '-')}.png")
        for label, value in slopes.items():
            print(f"| {name} | {label} | {value[0]:.2f} ({value[1]:.2f} to {value[2]:.2f}) |", flush=True)


if __name__ == "__main__":
    main()
