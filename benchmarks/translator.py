"""Time and memory of the translator for large CSG trees, and its delay after keystrokes in an editor.

    python benchmarks/translator.py trees [1000 10000] [--tree grid point ...]
    python benchmarks/translator.py keystrokes [1000 10000]

The tree ``field`` is a union of random primitives. ``carved`` is a block; half of the primitives are subtracted from
it, and the others are added and subtracted in alternation. The primitives of ``grid`` do not touch. ``plate`` has a
hole at each point of a grid, and ``pegs`` has a peg at each point. In ``comb`` each box overlaps the next box, and the
boxes are added and subtracted in alternation; ``point`` is a union of boxes that all overlap. Times are processor
seconds, and each measurement runs in a new process. ``changed`` is the time of a translation after a change of one
SURFACE, with the cache of the first translation. ``keystrokes`` measures the elapsed milliseconds from a change of the
text to its diagnostics, for a client of the language server.
"""

from __future__ import annotations

import argparse
import asyncio
import math
import random
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
import prosim_scene
from lsprotocol import types as lsp
from pygls.lsp.client import LanguageClient

TREES = ("field", "carved", "grid", "plate", "pegs", "comb", "point")
URI = "file:///nowhere/scene.scn"


def operators(kind: str, count: int) -> list[str]:
    """Returns the operators of the CSG tree; the first operator is applied last."""
    alternating = ["+-"[i % 2] for i in range(count - 1)][::-1]
    if kind == "carved":
        half = (count - 1) // 2
        return alternating[: count - 1 - half] + ["-"] * half
    if kind == "comb":
        return alternating
    return ["-" if kind == "plate" else "+"] * (count - 1)


def scene(kind: str, count: int) -> str:
    """Returns the text of a scene with ``count`` primitives."""
    rng, row = random.Random(1), math.ceil(count**0.5)
    plane = kind in ("grid", "plate", "pegs")
    side = row + 1.0 if plane else 0.6 * count if kind == "comb" else 2.0 * count ** (1 / 3)
    shapes = {"plate": ["CYLINDER"], "pegs": ["CYLINDER"], "comb": ["CUBE"], "point": ["CUBE"]}
    words = shapes.get(kind, ["CUBE", "SPHERE", "CYLINDER", "CONE"])
    lines = [
        "LIGHTS POINT position 0 0 99 Intensity 60000 60000 60000",
        f"VIEW EYE 0 0 {2 * side} VRP 0 0 0 WINDOW {-side} {-side} {side} {side} RESOLUTION 500 500",
        "CSG-TREE",
        *operators(kind, count),
        "CUBE 0",
        *(f"{words[i % len(words)]} {i}" for i in range(1, count)),
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
        elif plane:
            transform = f"SCALE (.3 .3 {side}) TRANSLATE ({cell} {-3 * side / 4})"
        lines += [f"SURFACE {i} material lambertian kd = 0.{1 + i % 8} 0.5 0.5", f"TRANSFORM {i} {transform}"]
    return "\n".join([*lines, "END", ""])


def measure(kind: str, count: int) -> None:
    """Measures a tree in this process, and prints a row of the table."""
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bench.scn"
        path.write_text(scene(kind, count))
        prosim_scene.parse("END")  # compiles the parser before the measurement
        before, cache = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, prosim_scene.TranslationCache()
        times = [time.process_time()]
        prosim_scene.parse(prosim_scene.read(path))
        times.append(time.process_time())
        prosim_scene.translate(path, cache=cache)
        times.append(time.process_time())
        path.write_text(path.read_text().replace("SURFACE 1 material lambertian", "SURFACE 1"))
        changed = prosim_scene.document(path)
        begun = time.process_time()
        prosim_scene.translate(changed, cache=cache)
        seconds = [*np.diff(times), time.process_time() - begun]
    peak = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    print(f"| {kind} | {count} | " + " | ".join(f"{s:.2f}" for s in seconds) + f" | {peak:.0f} |", flush=True)


async def keystrokes(count: int, keys: int = 100) -> None:
    """Types a character into ``keys`` random SURFACE lines, and prints a row of the table."""
    client, reports = LanguageClient("keystrokes", "1"), asyncio.Queue()
    client.feature(lsp.TEXT_DOCUMENT_PUBLISH_DIAGNOSTICS)(lambda report: reports.put_nowait(report))  # noqa: PLW0108  (pygls marks the function)
    await client.start_io(
        sys.executable, "-c", "import prosim_scene.editor.language_server as it; it.language_server()"
    )
    await client.initialize_async(lsp.InitializeParams(lsp.ClientCapabilities(), root_uri="file:///nowhere"))
    text, rng, found = scene("grid", count), random.Random(1), []
    places = [i for i, line in enumerate(text.splitlines()) if "kd =" in line]
    client.text_document_did_open(lsp.DidOpenTextDocumentParams(lsp.TextDocumentItem(URI, "scn", 1, text)))
    await reports.get()
    await asyncio.sleep(1.0)  # waits for the diagnostics of the meshes
    for key in range(keys):
        while not reports.empty():
            reports.get_nowait()
        lines = text.splitlines(keepends=True)
        line = rng.choice(places)
        lines[line] = lines[line][:40] + rng.choice("12x") + lines[line][40:]
        text = "".join(lines)
        change = lsp.TextDocumentContentChangeWholeDocument(text)
        version = lsp.VersionedTextDocumentIdentifier(key + 2, URI)
        begun = time.perf_counter()
        client.text_document_did_change(lsp.DidChangeTextDocumentParams(version, [change]))
        await reports.get()
        found.append(1000 * (time.perf_counter() - begun))
    await client.shutdown_async(None)
    client.exit(None)
    await client.stop()
    print(f"| {count} | " + " | ".join(f"{v:.0f}" for v in np.percentile(found, [50, 95, 100])) + " |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["trees", "keystrokes"])
    parser.add_argument("counts", nargs="*", type=int, default=[1000, 10000], metavar="COUNT")
    parser.add_argument("--tree", nargs="+", choices=TREES, default=TREES)
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        measure(options.tree[0], options.counts[0])
    elif options.what == "keystrokes":
        print("| primitives | median ms | 95 % | longest |\n|---:|---:|---:|---:|")
        for count in options.counts:
            asyncio.run(keystrokes(count))
    else:
        print("| tree | primitives | read s | translate s | changed s | peak MiB |\n|---|" + "---:|" * 5, flush=True)
        for kind in options.tree:
            for count in options.counts:
                subprocess.run([sys.executable, __file__, "trees", str(count), "--tree", kind, "--one"], check=True)


if __name__ == "__main__":
    main()
