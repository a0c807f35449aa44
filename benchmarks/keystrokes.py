"""How soon the language server says what is wrong after a keystroke, in long scenes.

    python benchmarks/keystrokes.py [--lines N ...] [--keys N]

A client as an editor's opens a scene, and types digits into parameters from the first line to the last, and words
that are wrong now and then. Milliseconds by the clock from a keystroke to its diagnostics, in the server's process.
"""

import argparse
import asyncio
import random
import statistics
import sys
import time

from lsprotocol import types as lsp
from pygls.lsp.client import LanguageClient

URI = "file:///nowhere/scene.scn"


def scene(lines):
    """A union of spheres, with a SURFACE and a TRANSFORM of two lines each."""
    count = (lines - 3) // 5
    text = ["VIEW OBS 0 0 50 VRP 0 0 0", "LIGHTS POINT position 0 9 9", "CSG-TREE " + "+ " * (count - 1)]
    text += [f"    SPHERE {i}" for i in range(count)]
    for i in range(count):
        text += [f"SURFACE {i} material lambertiano", "    kd = .5 .4 .3"]
        text += [f"TRANSFORM {i} SCALE (.4 .4 .4)", f"    TRANSLATE ({i % 30} {i // 30} 0)"]
    return [*text, "END"]


async def measure(lines, keys):
    """Milliseconds of each keystroke, and of opening."""
    client, told = LanguageClient("keystrokes", "1"), asyncio.Queue()

    @client.feature(lsp.TEXT_DOCUMENT_PUBLISH_DIAGNOSTICS)
    def note(params):
        told.put_nowait(params)

    await client.start_io(sys.executable, "-c", "import prosim_scene.language_server as it; it.language_server()")
    await client.initialize_async(lsp.InitializeParams(lsp.ClientCapabilities(), root_uri="file:///nowhere"))
    text, rng, found = scene(lines), random.Random(1), []
    begin = time.perf_counter()
    client.text_document_did_open(lsp.DidOpenTextDocumentParams(lsp.TextDocumentItem(URI, "scn", 1, "\n".join(text))))
    await told.get()
    opened = 1000 * (time.perf_counter() - begin)
    await asyncio.sleep(1.0)  # the tree's findings, if any
    places = [i for i, line in enumerate(text) if "kd =" in line]
    for key in range(keys):
        while not told.empty():
            told.get_nowait()
        line = rng.choice(places)
        at = lsp.Range(lsp.Position(line, 10), lsp.Position(line, 10))
        version = lsp.VersionedTextDocumentIdentifier(key + 2, URI)
        begin = time.perf_counter()
        client.text_document_did_change(
            lsp.DidChangeTextDocumentParams(
                version, [lsp.TextDocumentContentChangePartial(at, rng.choice(["1", "2", "x"]))]
            )
        )
        await told.get()
        found.append(1000 * (time.perf_counter() - begin))
    await client.shutdown_async(None)
    client.exit(None)
    await client.stop()
    return opened, found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--lines", type=int, nargs="+", default=[1000, 10000], metavar="N")
    parser.add_argument("--keys", type=int, default=100, metavar="N")
    options = parser.parse_args()
    print(f"{'lines':>8} {'opened':>8} {'median':>8} {'95 %':>8} {'most':>8}")
    for lines in options.lines:
        opened, found = asyncio.run(measure(lines, options.keys))
        row = opened, statistics.median(found), sorted(found)[int(0.95 * len(found))], max(found)
        print(f"{lines:>8}", *(f"{value:8.0f}" for value in row))


if __name__ == "__main__":
    main()
