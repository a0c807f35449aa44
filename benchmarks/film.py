"""What a film costs: its frames by workers of one thread each, against their pure rendering.

    python benchmarks/film.py [SCENE] [--frames 48] [--samples 4] [--workers 2]

The frames are 256 x 256 pixels of ``volta``, or of another scene that says ``$frame``, with N² samples in each pixel
(``--samples`` is N), ``adaptive = none``. Pure rendering is that of one process with as many threads, which has loaded
each scene and compiled its kernels before: the sum of the frames. The film is what ``prosim render --frames`` takes, by
one process and by workers; the ratio is of what the frames take after the first, which the same command has made alone.
Beside the seconds of the clock are those of the processors, of all processes together, which say more where a machine
has other things to do.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

VOLTA = Path(__file__).parents[1] / "examples" / "volta.scn"


def pure(scene: Path, frames: int, n: int, threads: int) -> tuple[float, float]:
    """``(seconds, seconds of the processors)`` of rendering all frames but the first."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    import drjit as dr
    import mitsuba_prosim  # noqa: F401  (registers the plugins)
    from mitsuba_prosim.scene import atomic, scene_file

    dr.set_thread_count(threads)
    clock = processors = 0.0
    with atomic.scratch() as folder:
        for number in range(frames):
            definitions, integrator = {"frame": str(number)}, {"adaptive": "none"}
            file = scene_file.SceneFile(
                scene, folder, definitions=definitions, resolution=(256, 256), samples=n, integrator=integrator
            )
            loaded = file.load()
            start, before = time.perf_counter(), time.process_time()
            loaded.integrator().render(loaded, seed=number)
            if number:
                clock, processors = clock + time.perf_counter() - start, processors + time.process_time() - before
    return clock, processors


def film(scene: Path, frames: int, n: int, options: list[str]) -> tuple[float, float]:
    """``(seconds, seconds of the processors)`` of the command."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-c", "from prosim_start import main; main()", "render", str(scene)]
        command += ["--frames", f"0:{frames}", "--resolution", "256x256", "--samples", str(n), "--adaptive", "none"]
        start, before = time.perf_counter(), os.times()
        subprocess.run([*command, "-o", f"{folder}/frame", *options], check=True, capture_output=True)
        took, after = time.perf_counter() - start, os.times()
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return took, used


def measure(scene: Path, frames: int, n: int, workers: int) -> None:
    """Both, and what they are over the pure rendering."""
    rendering = pure(scene, frames, n, workers)
    print(f"pure rendering of {frames - 1} frames: {rendering[0]:.2f} s, {rendering[1]:.2f} of the processors")
    for name, options in (("one process", ["-t", str(workers)]), ("workers", ["--workers", str(workers)])):
        options = [*options, "-t", str(workers)]
        first, whole = film(scene, 1, n, options), film(scene, frames, n, options)
        clock, processors = ((w - f) / r for w, f, r in zip(whole, first, rendering))
        print(
            f"{name}: {whole[0]:.2f} s ({whole[1]:.2f} of the processors), of which {first[0]:.2f} ({first[1]:.2f}) "
            f"for the first frame; ratio of the others {clock:.3f} (of the processors {processors:.3f})",
            flush=True,
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="?", type=Path, default=VOLTA)
    for name, default in (("frames", 48), ("samples", 4), ("workers", 2)):
        parser.add_argument(f"--{name}", type=int, default=default)
    asked = parser.parse_args()
    measure(asked.scene, asked.frames, asked.samples, asked.workers)
