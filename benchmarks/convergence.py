"""Error against time and against samples: the prosim integrator beside Mitsuba's integrators and samplers.

    python benchmarks/convergence.py [--scene penumbra ...] [--size 256] [--rounds 5] [--only REGEX] [--quick]
                                    [--output FOLDER]

For each scene, prints a table (Markdown) and writes ``SCENE.png`` (curves) and ``SCENE.json`` to the output folder.
References are converged images, kept in a cache folder and continued when ``--reference-seconds`` grants more time.

All runs of a scene take turns, so that other load on the machine slows them down alike: compare ratios within one
table. "CPU s" is processor time divided by the number of threads, which other load disturbs less than the clock's "s";
gains are in CPU s. Times are medians of warm runs; "cold" is the first run in the process, with the kernels on Dr.Jit's
disk cache if the scene has been measured before. Samples are those really taken. Images are scaled so that the
reference's mean is 0.25.
"Gain": how many times less time than the best of Mitsuba's samplers takes for an equal error, by its own curve; ">":
none of their curves gets there, and this is against the largest run of the fastest.
"""

import argparse
import json
import re
import tempfile
from pathlib import Path

import mitsuba as mi
import mitsuba_prosim  # noqa: F401  (registers the plugins)
from mitsuba_prosim.compare import measures, runs
from mitsuba_prosim.compare.scenes import Spec
from scenes import SCENES

SAMPLERS = ("independent", "stratified", "multijitter", "ldsampler", "orthogonal")
COUNTS = (4, 16, 64, 256)
OURS = (
    [f"prosim,adaptive=none,samples={n}" for n in (2, 3, 5, 8, 12)]
    + [f"prosim,samples=5,threshold={t}" for t in (0.0015, 0.003, 0.006, 0.012, 0.024)]
    + [f"prosim,samples={n},threshold={t}" for n in (3, 8) for t in (0.003, 0.006, 0.012)]
    + [f"prosim,adaptive=thesis,samples={n},threshold={t}" for n in (5, 8) for t in (0.01, 0.0025)]
)
MEASURES = {"rmse": "RMSE", "tone_mapped_rmse": "tone-mapped", "percentile99": "99 %", "relative_mse": "relMSE"}


def measure(case, size, rounds, seconds, cache, folder, chosen):
    """Runs of one scene: ``(results, references)``."""
    scene = case.open(size, folder)
    our_transport, their_transport = case.transports
    integrator = next(iter(case.theirs))
    ours = [scene.contestant(Spec(text), our_transport) for text in OURS if chosen(text)]
    theirs = [
        scene.contestant(Spec(f"{integrator}:{sampler}"), their_transport, spp=count)
        for sampler in SAMPLERS
        for count in COUNTS
        if chosen(f"{sampler} {count}")
    ]
    our_best = scene.contestant(Spec("prosim,adaptive=none,samples=12"), our_transport)
    their_best = scene.contestant(Spec(f"{integrator}:multijitter"), their_transport, spp=144)
    groups = (
        [(ours + theirs, [our_best, their_best])] if case.same_light else [(ours, [our_best]), (theirs, [their_best])]
    )
    references = []
    for k, (contestants, estimators) in enumerate(groups):
        reference = runs.reference(cache, f"{scene.key} {case.transports} {k}", estimators, seconds / len(groups))
        references.append(reference)
        for contestant in contestants:
            contestant.reference, contestant.scale = reference, 0.25 / reference.image.mean()
    return runs.by_turns(ours + theirs, rounds, measures.CHEAP), references


def curves(results):
    """Groups runs that differ in the sample count alone: name -> runs."""
    result = {}
    for run in results:
        name = (
            run.contestant.name.partition(",threshold")[0]
            if "threshold" in run.contestant.name
            else run.contestant.name.partition(",samples")[0]
        )
        result.setdefault(name, []).append(run)
    return result


def gains(run, rivals, measure):
    """How many times less than the best of ``rivals`` (curves) ``run`` takes for its error.

    ``(times, samples, reached)``, None where rivals begin below that error.
    """
    error, result = run.median(measure), []
    for cost in (lambda r: r.median("cpu"), lambda r: r.samples):
        found = [
            measures.relative_cost(cost(run), error, [cost(r) for r in curve], [r.median(measure) for r in curve])
            for curve in rivals
        ]
        reached = [ratio for ratio, there in filter(None, found) if there]
        result.append(min(reached) if reached else None if None in found else min(ratio for ratio, _ in found))
    return *result, bool(reached)


def table(results):
    """Rows of the table, as dictionaries."""
    groups = curves(results)
    theirs = [c for name, c in groups.items() if not name.startswith("prosim")]
    uniform = [c for name, c in groups.items() if name == "prosim,adaptive=none"]
    rows = []
    for run in results:
        name = run.contestant.name
        row = {
            "name": name.replace("prosim,", ""),
            "samples": run.samples,
            "seconds": run.median("seconds"),
            "cpu": run.median("cpu"),
            "fastest": min(run.seconds),
            "slowest": max(run.seconds),
            "cold": run.cold,
            **{m: run.median(m) for m in MEASURES},
        }
        if name.startswith("prosim"):
            row["gain"] = {m: gains(run, theirs, m) for m in MEASURES}
            if "adaptive=none" not in name:
                row["gain_over_own_uniform"] = {m: gains(run, uniform, m) for m in MEASURES}
        rows.append(row)
    return rows


def markdown(rows):
    """The table as Markdown."""

    def gain(row, m, kind="gain"):
        if kind not in row:
            return ""
        time, _, reached = row[kind][m]
        return "–" if time is None else f"{'' if reached else '>'}{time:.1f}"

    lines = [
        "| | spp | CPU s | s | cold s | RMSE | tone-mapped | 99 % | relMSE | gain RMSE | tone-m. | 99 % "
        "| own RMSE | tone-m. |",
        "|---" + "|---:" * 12 + "|",
    ]
    for row in rows:
        cells = [
            row["name"],
            f"{row['samples']:.1f}",
            f"{row['cpu']:.3f}",
            f"{row['seconds']:.3f}",
            f"{row['cold']:.2f}",
            *(f"{row[m]:.5f}" for m in MEASURES),
            *(gain(row, m) for m in list(MEASURES)[:3]),
            *(gain(row, m, "gain_over_own_uniform") for m in list(MEASURES)[:2]),
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def plot(name, results, path):
    """Curves of two measures against time and samples."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(2, 2, figsize=(13, 9), sharey="row")
    for row, measure in zip(axes, ("rmse", "tone_mapped_rmse")):
        for axis, cost, label in zip(
            row, (lambda r: r.median("cpu"), lambda r: r.samples), ("CPU seconds", "samples a pixel")
        ):
            for curve, points in curves(results).items():
                points = sorted(points, key=cost)
                ours = curve.startswith("prosim")
                axis.loglog(
                    [cost(r) for r in points],
                    [r.median(measure) for r in points],
                    "o-" if ours else "x:",
                    label=curve.replace("prosim,", "ours, "),
                    linewidth=1.8 if ours else 1,
                )
            axis.set_xlabel(label)
            axis.grid(True, which="both", alpha=0.25)
        row[0].set_ylabel(MEASURES[measure])
    axes[0, 1].legend(fontsize=7)
    figure.suptitle(name)
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    pyplot.close(figure)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", nargs="+", choices=list(SCENES), default=list(SCENES))
    parser.add_argument("--size", type=int, default=256, help="width and height in pixels")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--reference-seconds", type=float, default=60)
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--output", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--cache", type=Path, default=runs.cache_folder())
    parser.add_argument(
        "--only",
        metavar="REGEX",
        default=".",
        help="contestants: those whose 'prosim,PARAMETERS' or 'SAMPLER COUNT' holds a match",
    )
    parser.add_argument("--quick", action="store_true", help="64 x 64 pixels, few runs: to see that it works")
    options = parser.parse_args()
    if options.quick:
        options.size, options.rounds, options.reference_seconds = 64, 2, 2
        options.only = "samples=5|multijitter (4|16)$"
    mi.set_variant(options.variant)
    mi.set_log_level(mi.LogLevel.Error)
    options.output.mkdir(parents=True, exist_ok=True)
    print(", ".join(f"{key} {value}" for key, value in runs.machine().items()))
    for name in options.scene:
        with tempfile.TemporaryDirectory() as folder:
            results, references = measure(
                SCENES[name],
                options.size,
                options.rounds,
                options.reference_seconds,
                options.cache,
                folder,
                re.compile(options.only).search,
            )
        scale = results[0].contestant.scale
        rows = table(results)
        print(f"\n## {name}, {options.size} x {options.size}\n")
        for reference in references:
            print(
                f"Reference: standard error {reference.error * scale:.5f}"
                + (
                    ""
                    if reference.disagreement is None
                    else f"; ours and theirs differ by {reference.disagreement:.2f} times their noise, their means by "
                    f"{reference.mean_difference:+.1f} standard errors"
                )
            )
        print("\n" + markdown(rows), flush=True)
        plot(name, results, options.output / f"{name}.png")
        facts = {
            "scene": name,
            "size": options.size,
            "rounds": options.rounds,
            "machine": runs.machine(),
            "scale": scale,
            "references": [
                {
                    "error": r.error,
                    "seconds": r.seconds,
                    "disagreement": r.disagreement,
                    "mean_difference": r.mean_difference,
                }
                for r in references
            ],
            "rows": rows,
        }
        (options.output / f"{name}.json").write_text(json.dumps(facts, indent=1))


if __name__ == "__main__":
    main()
