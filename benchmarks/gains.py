"""Gains at equal time: one table for each question.

    python benchmarks/gains.py policies [--scene palito ...] [--size 256] [--rounds 10]
    python benchmarks/gains.py paths --scene "Cornell box" staircase2 --folder SCENES
    python benchmarks/gains.py targets --scene lego --folder SCENES
    python benchmarks/gains.py denoised | in-time | ablations

``policies``
    The thesis's tree of rays with the policies ``graded`` and ``neighbours``, compared with the policy ``none``, for
    N = 8 and the same mean number of samples.
``paths``
    ``prosim`` with all light paths, and ``path`` nested in ``prosim_adaptive``, compared with ``path`` and the sampler
    ``independent``, at 64 samples per pixel. Scenes whose tree has one level (stage, copper ball, metal floor, 24
    lamps) have only direct light, and ``direct`` instead of ``path``.
``targets``
    Renders to a given noise by ``prosim`` with all light paths, compared with ``path`` and the sampler ``multijitter``
    at 64 samples, whose error is the noise. So ``path`` knows beforehand how many samples it needs.
``denoised``
    ``prosim_denoised``, compared with the raw image of the same number of samples.
``in-time``
    The same, for images that take eight seconds each.
``ablations``
    ``graded`` without one of its parts, compared with the complete ``graded``. The part is adaptive sampling, the
    second judgement (the refinement then ends after one more pass), or the project's light sampling (each emitter's
    own sampling is then used).

A cell is a gain in processor time with its 95 % interval. The column ``samples: tone-mapped`` is a gain in samples.
"""

from __future__ import annotations

import argparse
from typing import Any
from unittest import mock

import numpy as np
from measure import MEASURES, Run, arguments, begin, gain, reference, render_in_turn, shown
from mitsuba_prosim.engine.standard_error import displayed
from mitsuba_prosim.light import table as lights
from subjects import DEPTH, Subject

#: The paths of this integrator are as long as those of ``path`` with DEPTH edges: the vertices between camera and lamp
#: are the levels 0 to DEPTH - 2.
PATHS = {"type": "prosim", "diffuse_bounces": -1, "max_level": DEPTH - 2}
NESTED = {"type": "prosim_adaptive", "nested": {"type": "path", "max_depth": DEPTH}}
Entries = tuple[list[Run], dict[str, Any], int]


def with_samples(run: Run, wanted: float) -> Run:
    """Returns ``run`` with a threshold for which a pixel has about ``wanted`` samples on average."""
    low, high, found = 1e-4, 1.0, run
    for _ in range(10):
        threshold = (low * high) ** 0.5
        found = Run(run.name, run.scene, run.integrator | {"threshold": threshold}, run.spp)
        samples = found.samples().mean()
        if abs(samples / wanted - 1) < 0.05:
            break
        low, high = (threshold, high) if samples > wanted else (low, threshold)
    return found


def policies(subject: Subject, n: int = 8) -> Entries:
    """Returns the runs of the table ``policies``: ``(entries, integrator, samples)``.

    The last entry is the baseline. ``integrator`` and ``samples`` describe the reference.
    """
    scene, tree = subject.load(), subject.tree or NESTED
    uniform = Run("none", scene, tree | {"adaptive": "none", "samples": n})
    graded = Run("graded", scene, tree | {"adaptive": "graded", "samples": n, "max_samples": 4 * n * n})
    neighbours = Run("neighbours", scene, tree | {"adaptive": "neighbours", "samples": round(1.6 * n)})
    return [*(with_samples(run, n * n) for run in (graded, neighbours)), uniform], uniform.integrator, 0


def paths(subject: Subject, n: int = 8) -> Entries:
    """Returns the runs of the table ``paths``, in the form of :func:`policies`."""
    scene, ours, theirs = subject.load(), PATHS, {"type": "path", "max_depth": DEPTH}
    if subject.tree and subject.tree.get("max_level") == 0:
        ours, theirs = subject.tree, {"type": "direct"}
    name, nested = theirs["type"], {"type": "prosim_adaptive", "nested": theirs}
    entries = [
        Run("prosim", scene, ours | {"adaptive": "none"}, n * n),
        with_samples(Run("prosim, graded", scene, ours | {"adaptive": "graded", "samples": n}), n * n),
        Run("prosim_adaptive", scene, nested | {"adaptive": "none"}, n * n),
        with_samples(Run("prosim_adaptive, graded", scene, nested | {"adaptive": "graded", "samples": n}), n * n),
        Run(f"{name}, owen", subject.load("owen"), theirs, n * n),
        Run(f"{name}, multijitter", subject.load("multijitter"), theirs, n * n),
        Run(name, scene, theirs, n * n),
    ]
    return entries, theirs, 256


def targets(subject: Subject, n: int = 8) -> Entries:
    """Returns the runs of the table ``targets``, in the form of :func:`policies`."""
    scene, theirs = subject.load(), {"type": "path", "max_depth": DEPTH}
    fixed = Run("path, multijitter", subject.load("multijitter"), theirs, n * n)
    weights = [0.212671, 0.715160, 0.072169]  # of the luminance
    first, second = (displayed(fixed.render(seed)[0] @ weights) for seed in (1, 2))
    noise = float(np.sqrt(np.mean(np.square(first - second)) / 2))
    return [Run("--noise", scene, PATHS | {"noise": noise}), fixed], theirs, 256


def denoised(subject: Subject, n: int = 6) -> Entries:
    """Returns the runs of the table ``denoised``, in the form of :func:`policies`."""
    scene, nested = subject.load(), (subject.tree or subject.adaptive) | {"adaptive": "none", "samples": n}
    return [Run("denoised", scene, {"type": "prosim_denoised", "nested": nested}), Run("raw", scene, nested)], nested, 0


def in_time(subject: Subject, seconds: float = 8) -> Entries:
    """Returns the runs of the table ``in-time``, in the form of :func:`policies`."""
    scene, tree = subject.load(), subject.tree or subject.adaptive
    nested = tree | {"time": seconds}
    runs = [Run("denoised", scene, {"type": "prosim_denoised", "nested": nested}), Run("raw", scene, nested)]
    return runs, tree | {"adaptive": "none", "samples": 8}, 0


def ablations(subject: Subject, n: int = 8) -> Entries:
    """Returns the runs of the table ``ablations``, in the form of :func:`policies`."""
    scene, tree = subject.load(), subject.tree or PATHS
    graded = tree | {"adaptive": "graded", "samples": n, "max_samples": 4 * n * n}
    whole = with_samples(Run("graded", scene, graded), n * n)
    emitters = OtherLights("Mitsuba's light sampling", subject.load(), whole.integrator)
    once = with_samples(Run("one judgement", scene, graded | {"max_samples": 2 * n * n}), n * n)
    uniform = Run("not adaptive", scene, tree | {"adaptive": "none", "samples": n})
    return [uniform, once, emitters, whole], uniform.integrator, 0


class OtherLights(Run):
    """A run in which the plugin of each light samples the light, instead of the project's strategies."""

    def render(self, seed: int) -> tuple[np.ndarray, float]:
        """Renders with the light sampling of each light's own plugin."""
        with mock.patch.object(lights, "STRATEGIES", lights.STRATEGIES[-1:]):
            return super().render(seed)


TABLES = {
    "policies": policies,
    "paths": paths,
    "targets": targets,
    "denoised": denoised,
    "in-time": in_time,
    "ablations": ablations,
}


def rows(subject: Subject, table: str, options: argparse.Namespace) -> None:
    """Prints a row of the table for each entry except the baseline."""
    entries, integrator, spp = TABLES[table](subject)
    truth = reference(subject, integrator, spp, options.reference_seconds, options.cache)
    render_in_turn(entries, truth, options.rounds)
    for entry in entries[:-1]:
        by_time, by_samples = gain(entry, entries[-1]), gain(entry, entries[-1], "samples")
        times = np.median(np.array(entry.seconds) / np.array(entries[-1].seconds))
        cells = [f"{entry.samples().mean():.1f}", f"{times:.2f}", shown(by_samples[:, 0]), *map(shown, by_time.T)]
        print(f"| {subject.name} | {entry.name} | " + " | ".join(cells) + " |", flush=True)


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("table", choices=TABLES)
    options = parser.parse_args()
    begin(options)
    print("| | | samples | time | samples: tone-mapped | " + " | ".join(MEASURES) + " |")
    print("|---|---|---:|---:|" + "---:|" * (len(MEASURES) + 1))
    for name in options.scene:
        rows(Subject(name, options.size, options.folder), options.table, options)


if __name__ == "__main__":
    main()
