"""Time and memory of translating CSG trees, by their number of primitives.

    python benchmarks/csg.py [--pairwise] [COUNT ...]

Two kinds of trees: `field` is a union of random primitives, left-deep as in the thesis's listing; `carved` is a block
from which half of the primitives are taken away, then half are added and taken away in turn. `--pairwise` also times
what is usual elsewhere, one union after the other in the order of the tree. Each measurement runs in its own process.
"""

import argparse
import random
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def scene(kind, count, seed=1):
    """The text of a scene with ``count`` primitives of about the same density at any count."""
    rng = random.Random(seed)
    side = 2.0 * count ** (1 / 3)
    shapes = ["CUBE", "SPHERE", "CYLINDER", "CONE"]
    leaves = [f"{shapes[i % 4]} {i}" for i in range(1, count)]
    if kind == "field":
        tree = ["+"] * (count - 1) + ["CUBE 0", *leaves]
    else:
        half = len(leaves) // 2
        operators = ["-"] * half + ["+-"[i % 2] for i in range(len(leaves) - half)]
        tree = [*operators[::-1], "CUBE 0", *leaves]
    lines = [
        "NAME: bench",
        "LIGHTS POINT position 0 0 99 Intensity 60000 60000 60000",
        f"VIEW OBS 0 0 {2 * side} VRP 0 0 0 WINDOW {-side} {-side} {side} {side} RESOLUTION 500 500",
        "CSG-TREE",
        *tree,
    ]
    for i in range(count):
        x, y, z = (rng.uniform(-side / 2, side / 2) for _ in range(3))
        if i == 0:
            transform = f"SCALE ({side} {side} {side / 2}) TRANSLATE ({-side / 2} {-side / 2} {-side / 2})"
        else:
            transform = (
                f"SCALE ({rng.uniform(0.3, 1):.3f} {rng.uniform(0.3, 1):.3f} {rng.uniform(0.3, 1):.3f}) "
                f"ROTATE-X ({rng.uniform(0, 360):.2f}) ROTATE-Z ({rng.uniform(0, 360):.2f}) "
                f"TRANSLATE ({x:.4f} {y:.4f} {z:.4f})"
            )
        lines += [f"SURFACE {i} material lambertiano kd = 0.{1 + i % 8} 0.5 0.5", f"TRANSFORM {i} {transform}"]
    return "\n".join([*lines, "END", ""])


def measure(kind, count, pairwise):
    """Prints seconds of reading and of the whole, processor seconds of the whole, and mebibytes.

    The latter at the peak, above those of the imports, and of the meshes.
    """
    import warnings

    import prosim_scene
    from prosim_scene.solids import csg, parts

    warnings.simplefilter("ignore")
    if pairwise:

        def union(operands):
            result = []
            for part in (p for operand in operands for p in operand):
                result = parts.as_parts(part.manifold + result[0].manifold) if result else [part]
            return result

        csg.union = union
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bench.scn"
        path.write_text(scene(kind, count))
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        prosim_scene.parse("END")  # makes the parser, once a process
        start = time.perf_counter()
        prosim_scene.parse(prosim_scene.read(path))
        parsed, processor = time.perf_counter(), time.process_time()
        prosim_scene.translate(path)
        end, processor = time.perf_counter(), time.process_time() - processor
        size = sum(f.stat().st_size for f in Path(folder).rglob("*.ply"))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    mebibytes = (peak - before) / 1024, size / 2**20
    print(
        f"{kind:>7} {count:>7} {parsed - start:9.2f} {end - parsed:9.2f} {processor:9.2f} {mebibytes[0]:9.0f} "
        f"{mebibytes[1]:9.1f}"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("counts", nargs="*", type=int, default=[100, 1000, 10000], metavar="COUNT")
    parser.add_argument("--pairwise", action="store_true")
    parser.add_argument("--one", choices=["field", "carved"], help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        return measure(options.one, options.counts[0], options.pairwise)
    print(f"{'tree':>7} {'leaves':>7} {'read s':>9} {'all s':>9} {'cpu s':>9} {'MiB':>9} {'PLY MiB':>9}")
    for kind in ("field", "carved"):
        for count in options.counts:
            command = [sys.executable, __file__, "--one", kind, str(count), *["--pairwise"] * options.pairwise]
            subprocess.run(command, check=True)
    return None


if __name__ == "__main__":
    main()
