"""Time for compilation, kernel launches, the start of the command and the live view; peak memory.

    python benchmarks/speed.py [--scene penumbra palito] [--size 500] [--rounds 9]
    python benchmarks/speed.py --live [--scene palito]

Each row is measured in new processes. ``cold`` is the time of the first render with an empty kernel cache of Dr.Jit.
``cached`` is the time of the first render of a second process. ``warm`` is the median time of further renders.
``without a kernel`` is the fraction of the warm time in which no kernel runs. ``compiled again`` is the number of
kernels that Dr.Jit compiles for another seed, threshold, number of samples, resolution and crop; 0 is correct.
``--live`` saves a scene repeatedly while ``prosim watch`` shows it, and renders the scene in turn. It prints the ratio
of the processor seconds of watching and rendering, with its 95 % interval.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import psutil
from measure import Run, arguments, begin, interval, shown
from subjects import EXAMPLES, Subject


def probe(name: str, size: int, rounds: int) -> dict[str, Any]:
    """Measures one scene in this process; returns the results by name."""
    subject = Subject(name, size)
    scene, integrator = subject.load(), mi.load_dict((subject.tree or {"type": "prosim"}) | {"adaptive": "neighbours"})
    sensor = scene.sensors()[0]

    def render(seed: int = 0, spp: int = 0) -> None:
        """Renders an image, and waits for its end."""
        image = integrator.render(scene, sensor, seed=seed, spp=spp)
        dr.eval(image)
        dr.sync_thread()

    def resize(width: int, height: int, crop: tuple[int, int]) -> None:
        """Sets the size of the film and of its crop window."""
        film = mi.traverse(sensor)
        film["film.size"], film["film.crop_size"] = mi.ScalarVector2u(width, height), mi.ScalarVector2u(*crop)
        film["film.crop_offset"] = mi.ScalarPoint2u(0)
        film.update()

    def history(action: Callable[[], None]) -> tuple[list[dict[str, Any]], float]:
        """Returns ``(kernels, seconds)`` of an action."""
        dr.kernel_history_clear()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            begun = time.perf_counter()
            action()
            return dr.kernel_history(), time.perf_counter() - begun

    def compiled(action: Callable[[], None]) -> int:
        """Returns how many kernels an action compiles."""
        return sum(e["type"] == dr.KernelType.JIT and not e["cache_hit"] for e in history(action)[0])

    first = history(render)[1]
    render()
    warm = [history(render) for _ in range(rounds)]
    running = [sum(e["execution_time"] for e in entries) / 1e3 / wall for entries, wall in warm]
    again = {"seed": compiled(lambda: render(7)), "samples": compiled(lambda: render(spp=49))}
    integrator.threshold *= 0.7
    again["threshold"] = compiled(render)
    resize(size + 12, size + 8, (size + 12, size + 8))
    again["resolution"] = compiled(render)
    resize(size, size, (size // 2, size // 3))
    again["crop"] = compiled(render)
    return {
        "first": first,
        "warm": statistics.median(wall for _, wall in warm),
        "launches": len(warm[-1][0]),
        "idle": 1 - statistics.median(running),
        "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "again": again,
    }


def in_process(home: str, *values: object) -> dict[str, Any]:
    """Runs :func:`probe` in another process, whose kernel cache is in the folder ``home``; returns the results."""
    command = [sys.executable, __file__, "--probe", *map(str, values)]
    run = subprocess.run(command, env=os.environ | {"HOME": home}, capture_output=True, text=True, check=False)
    if run.returncode:
        raise SystemExit(run.stderr)
    return json.loads(run.stdout.splitlines()[-1])


def table(options: argparse.Namespace) -> None:
    """Prints a row of a table for each scene, and a table of the time to start the command."""
    print("| | cold s | cached s | warm s | launches | without a kernel | peak MiB | compiled again |")
    print("|---" * 8 + "|", flush=True)
    for name in options.scene:
        with tempfile.TemporaryDirectory() as home:
            cold = in_process(home, name, options.size, 1)
            r = in_process(home, name, options.size, options.rounds)
        again = ", ".join(f"{what} {count}" for what, count in r["again"].items())
        cells = [f"{cold['first']:.2f}", f"{r['first']:.2f}", f"{r['warm']:.3f}", f"{r['launches']}"]
        print(f"| {name} | " + " | ".join([*cells, f"{r['idle']:.1%}", f"{r['memory']:.0f}", again]) + " |", flush=True)
    print("\n| start | processor s |\n|---|---:|")
    for words in (["-c", "import mitsuba"], ["-c", "import mitsuba, mitsuba_prosim"], ["-m", "prosim_start", "-h"]):
        spent = [processor_seconds([sys.executable, *words]) for _ in range(options.rounds)]
        print(f"| `{' '.join(words)}` | {statistics.median(spent):.2f} |", flush=True)


def processor_seconds(command: list[str]) -> float:
    """Runs a command; returns its processor seconds."""
    before = psutil.Process().cpu_times()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    after = psutil.Process().cpu_times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def used(process: psutil.Process) -> float:
    """Returns the processor seconds that a process has used until now."""
    times = process.cpu_times()
    return times.user + times.system


def settle(process: psutil.Process, quiet: float = 1.0) -> float:
    """Waits until a process has been almost idle for ``quiet`` seconds; returns the processor seconds that it has
    used.
    """
    while True:
        before = used(process)
        time.sleep(quiet)
        if used(process) - before < 0.1 * quiet:
            return used(process)


def live(name: str, options: argparse.Namespace) -> None:
    """Prints a row of the table for a scene that ``prosim watch`` shows."""
    this, ratios = psutil.Process(), []
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(shutil.copy(EXAMPLES / f"{name}.scn", folder))
        command = [sys.executable, "-m", "prosim_start", "watch", str(scene), "--no-browser"]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            watch = psutil.Process(process.pid)
            settle(watch)
            for _ in range(options.rounds + 1):
                before = used(watch)
                scene.write_text(scene.read_text())
                spent, begun = settle(watch) - before, used(this)
                subject = Subject(name, options.size)
                Run("", subject.load(), subject.tree or {"type": "prosim"}).render(0)
                ratios.append(spent / (used(this) - begun))
            process.terminate()
    warm = np.array(ratios[1:])
    print(f"| {name} | {shown(interval(lambda k: np.median(warm[k]), options.rounds))} |", flush=True)


def main() -> None:
    parser = arguments(__doc__, 9)
    parser.set_defaults(scene=["penumbra", "palito"], size=500)
    parser.add_argument("--live", action="store_true", help="compare a save under prosim watch with a render")
    parser.add_argument("--probe", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    begin(options)
    if options.probe:
        name, size, rounds = options.probe
        print(json.dumps(probe(name, int(size), int(rounds))))
    elif options.live:
        print("| | watch over render |\n|---|---:|", flush=True)
        for name in options.scene:
            live(name, options)
    else:
        table(options)


if __name__ == "__main__":
    main()
