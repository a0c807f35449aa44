"""Time and memory of translating CSG trees, by their number of primitives.

    python benchmarks/csg.py [--trees TREE ...] [COUNT ...]

The trees: `field` is a union of random primitives, left-deep as in the thesis's listing; `carved` is a block from which
half of the primitives are taken away, then half are added and taken away in turn; `grid` is a union of primitives that
do not touch; `plate` one with a hole at each place of a grid, `pegs` one with a peg through it there; in `comb` each
box overlaps the next, and in `point` all overlap at one point, added and taken away in turn. `again` is the translation
of a scene of which one SURFACE has changed, with what the first one has left, and `moved cpu` are processor seconds of
that of one in which a primitive in the middle of the tree has moved; reading is not counted in these. Each measurement
runs in its own process.
"""

import argparse
import math
import random
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

TREES = ["field", "carved", "grid", "plate", "pegs", "comb", "point"]


def scene(kind, count, seed=1):
    """The text of a scene with ``count`` primitives of about the same density at any count."""
    rng = random.Random(seed)
    side = 2.0 * count ** (1 / 3)
    shapes = ["CUBE", "SPHERE", "CYLINDER", "CONE"]
    in_turn = ["+-"[i % 2] for i in range(count - 1)][::-1]  # the first operator of the text is the last one applied
    operators = ["+"] * (count - 1)
    row = math.ceil(count**0.5)
    if kind == "carved":
        half = (count - 1) // 2
        operators = in_turn[: count - 1 - half] + ["-"] * half
    elif kind in ("plate", "pegs"):
        shapes, operators = ["CYLINDER"], ["-" if kind == "plate" else "+"] * (count - 1)
    elif kind in ("comb", "point"):
        shapes, operators = ["CUBE"], in_turn
    if kind in ("grid", "plate", "pegs"):
        side = row + 1.0
    elif kind == "comb":
        side = 0.6 * count
    tree = [*operators, "CUBE 0", *(f"{shapes[i % len(shapes)]} {i}" for i in range(1, count))]
    lines = [
        "NAME: bench",
        "LIGHTS POINT position 0 0 99 Intensity 60000 60000 60000",
        f"VIEW OBS 0 0 {2 * side} VRP 0 0 0 WINDOW {-side} {-side} {side} {side} RESOLUTION 500 500",
        "CSG-TREE",
        *tree,
    ]
    for i in range(count):
        turn = f"ROTATE-X ({rng.uniform(0, 360):.2f}) ROTATE-Z ({rng.uniform(0, 360):.2f})"
        size = " ".join(f"{rng.uniform(0.3, 1):.3f}" for _ in range(3))
        place = " ".join(f"{rng.uniform(-side / 2, side / 2):.4f}" for _ in range(3))
        cell = f"{i % row - row / 2} {i // row - row / 2}"
        transform = f"SCALE ({size}) {turn} TRANSLATE ({place})"
        if kind == "grid":
            transform = f"SCALE (.3 .3 .3) TRANSLATE ({cell} 0)"
        elif kind == "comb":
            transform = f"SCALE (1 .5 .5) TRANSLATE ({0.6 * i - side / 2:.3f} {0.1 * (i % 3)} {0.07 * (i % 5)})"
        elif kind == "point":
            transform = f"TRANSLATE (-.5 -.5 -.5) SCALE ({size}) {turn}"
        elif i == 0:
            transform = f"SCALE ({side} {side} {side / 2}) TRANSLATE ({-side / 2} {-side / 2} {-side / 2})"
        elif kind in ("plate", "pegs"):
            transform = f"SCALE (.3 .3 {side}) TRANSLATE ({cell} {-3 * side / 4})"
        lines += [f"SURFACE {i} material lambertiano kd = 0.{1 + i % 8} 0.5 0.5", f"TRANSFORM {i} {transform}"]
    return "\n".join([*lines, "END", ""])


def measure(kind, count):
    """Prints seconds of reading, of the whole and of other times, processor seconds of the whole, and mebibytes.

    The latter at the peak, above those of the imports, and of the meshes.
    """
    import warnings

    import prosim_scene

    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bench.scn"
        path.write_text(scene(kind, count))
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        prosim_scene.parse("END")  # makes the parser, once a process
        start = time.perf_counter()
        prosim_scene.parse(prosim_scene.read(path))
        parsed, processor = time.perf_counter(), time.process_time()
        kept = prosim_scene.Kept()
        prosim_scene.translate(path, kept=kept)
        end, processor = time.perf_counter(), time.process_time() - processor
        path.write_text(path.read_text().replace("SURFACE 1 material lambertiano", "SURFACE 1"))
        changed = prosim_scene.document(path)
        begin = time.perf_counter()
        prosim_scene.translate(changed, kept=kept)
        again = time.perf_counter() - begin
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        place = f"TRANSFORM {count // 2} "
        path.write_text(path.read_text().replace(place, f"{place}TRANSLATE (.01 .02 .03) "))
        changed = prosim_scene.document(path)
        begin = time.process_time()
        prosim_scene.translate(changed, kept=kept)
        moved = time.process_time() - begin
        size = sum(f.stat().st_size for f in Path(folder).rglob("*.ply"))
    mebibytes = (peak - before) / 1024, size / 2**20
    print(
        f"{kind:>7} {count:>7} {parsed - start:9.2f} {end - parsed:9.2f} {processor:9.2f} {again:9.2f} {moved:9.2f} "
        f"{mebibytes[0]:9.0f} {mebibytes[1]:9.1f}"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("counts", nargs="*", type=int, default=[100, 1000, 10000], metavar="COUNT")
    parser.add_argument("--trees", nargs="+", choices=TREES, default=TREES[:2], metavar="TREE")
    parser.add_argument("--one", choices=TREES, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        return measure(options.one, options.counts[0])
    names = ["read s", "all s", "cpu s", "again s", "moved cpu", "MiB", "PLY MiB"]
    print(f"{'tree':>7} {'leaves':>7}", *(f"{name:>9}" for name in names))
    for kind in options.trees:
        for count in options.counts:
            command = [sys.executable, __file__, "--one", kind, str(count)]
            subprocess.run(command, check=True)
    return None


if __name__ == "__main__":
    main()
