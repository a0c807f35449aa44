"""Resumed, divided and distributed renders: checks that their images have the same bytes, and measures their cost.

    python benchmarks/distributed.py kills [--count 50] [--seed 1] [--size 96]
    python benchmarks/distributed.py costs [--size 1024] [--rounds 5]

``kills``: the program kills renders (``SIGKILL``, at random moments) and resumes them, kills workers, and merges parts.
It compares the pixels with those of an undisturbed render, for all policies and for films with box and gaussian
filters. The process ends with an error if the pixels differ. ``costs``: the processor seconds of ``--checkpoint``, of
two workers with one thread, and of four parts, divided by those of one render, with 95 % intervals. The renders take
turns.
"""

from __future__ import annotations

import argparse
import random
import subprocess
import sys
import tempfile
import time
from itertools import cycle, product
from pathlib import Path

import mitsuba as mi
import numpy as np
import psutil
from measure import interval, shown

SCENE = """<scene version="3.0.0">
    <integrator type="prosim_adaptive"><integrator type="path"/><integer name="band" value="2000"/>
        <float name="threshold" value="0.002"/></integrator>
    <sensor type="perspective"><float name="fov" value="60"/>
        <transform name="to_world"><lookat origin="0,1,4" target="0,0.5,0" up="0,1,0"/></transform>
        <film type="hdrfilm"><integer name="width" value="{size}"/><integer name="height" value="{size}"/>
            <rfilter type="{rfilter}"/></film>
    </sensor>
    <shape type="sphere"><point name="center" value="-1,2,1"/><float name="radius" value="0.2"/>
        <emitter type="area"><rgb name="radiance" value="9"/></emitter></shape>
    <shape type="sphere"><point name="center" value="0.5,0.6,0"/><float name="radius" value="0.6"/></shape>
    <shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/><scale value="3"/></transform></shape>
</scene>
"""
#: Policy -> the options of a render that takes some seconds.
POLICIES = {
    "none": ["--adaptive", "none", "--samples", "40"],
    "thesis": ["--adaptive", "thesis", "--samples", "40"],
    "neighbours": ["--adaptive", "neighbours", "--samples", "40"],
    "graded": ["--adaptive", "graded", "--samples", "20"],
    "noise": ["--noise", "0.002"],
}


def prosim(*arguments: object) -> subprocess.Popen[str]:
    """Starts the command ``prosim`` in a new process."""
    command = [sys.executable, "-m", "prosim_start", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def wait_for(process: subprocess.Popen[str], seconds: float | None = None) -> bool:
    """Waits for a process; returns whether it ended within ``seconds``. Raises SystemExit if the process failed."""
    try:
        text, _ = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        return False
    if process.returncode:
        raise SystemExit(f"{process.args} ended with {process.returncode}:\n{text}")
    return True


def processor_seconds(*arguments: object) -> float:
    """Runs ``prosim``; returns the processor seconds of the command and its workers."""
    before = psutil.Process().cpu_times()
    wait_for(prosim(*arguments))
    after = psutil.Process().cpu_times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def content(stem: Path) -> bytes:
    """Returns the pixels of the EXR file without its metadata, which contain the render time."""
    return np.array(mi.Bitmap(str(stem) + ".exr")).tobytes()


def workers(process: subprocess.Popen[str]) -> list[psutil.Process]:
    """Lists the worker processes that exist."""
    try:
        return [p for p in psutil.Process(process.pid).children() if "spawn_main" in " ".join(p.cmdline())]
    except psutil.Error:
        return []


def disturb(kind: int, stem: Path, scene: Path, options: list[str], seconds: float, chance: random.Random) -> int:
    """Renders a scene and disturbs the render; returns how many processes were killed.

    ``kind``: 0 kills the render and resumes it, 1 kills workers, 2 renders and merges parts.
    """
    if kind == 2:
        of = chance.randint(2, 6)
        for number in chance.sample(range(1, of + 1), of):
            wait_for(prosim("render", scene, *options, "--part", f"{number}/{of}", "-o", stem))
        parts = sorted(stem.parent.glob(f"{stem.name}.*-of-*.npz"))
        wait_for(prosim("merge", *chance.sample(parts, of), "-o", stem))
        return 0
    killed, state = 0, stem.with_name(stem.name + ".state.npz")
    more = ["--workers", chance.choice([2, 3])] if kind else []
    process = prosim("render", scene, "--checkpoint", "-o", stem, *options, *more)
    while not wait_for(process, chance.uniform(0.2, 0.9 * seconds) if killed < 3 else None):
        if kind and state.exists():
            for worker in chance.sample(there, 1) if (there := workers(process)) else []:
                worker.kill()
                killed += 1
        elif not kind:
            process.kill()
            process.wait()
            killed += 1
            begun = state.exists()
            process = (
                prosim("resume", state) if begun else prosim("render", scene, "--checkpoint", "-o", stem, *options)
            )
    return killed


def kills(folder: Path, options: argparse.Namespace) -> None:
    """Disturbs renders until ``--count`` processes have been killed, and checks the pixels of each render."""
    chance, killed, known = random.Random(options.seed), 0, {}
    for n, ((policy, rfilter), kind) in enumerate(cycle(product(product(POLICIES, ("box", "gaussian")), range(3)))):
        if killed >= options.count:
            break
        if policy == "noise" and kind == 2:
            continue  # --noise needs the whole image, so parts cannot have this option
        scene = folder / f"{rfilter}.xml"
        scene.write_text(SCENE.format(size=options.size, rfilter=rfilter))
        if (policy, rfilter) not in known:
            whole, begun = folder / f"whole-{policy}-{rfilter}", time.perf_counter()
            wait_for(prosim("render", scene, "-o", whole, *POLICIES[policy]))
            known[policy, rfilter] = content(whole), time.perf_counter() - begun
        expected, seconds = known[policy, rfilter]
        stem = folder / f"disturbed-{n}"
        count = disturb(kind, stem, scene, POLICIES[policy], seconds, chance)
        killed += count
        what = f"{policy}, {rfilter}, {('renders', 'workers', 'parts')[kind]}: {count} killed, {killed} in all"
        if content(stem) != expected:
            raise SystemExit(f"{what}: other pixels than an undisturbed render")
        print(f"{what}: the same pixels", flush=True)


def costs(folder: Path, options: argparse.Namespace) -> None:
    """Prints a row of the table for each way to render."""
    scene, one = folder / "box.xml", ["--adaptive", "none", "--samples", "8"]
    scene.write_text(SCENE.format(size=options.size, rfilter="box"))
    ways: dict[str, list[list[object]]] = {
        "one process": [one],
        "--checkpoint": [[*one, "--checkpoint"]],
        "--workers 2": [[*one, "--workers", 2]],
        "4 parts": [[*one, "--part", f"{k}/4"] for k in range(1, 5)],
    }
    seconds: dict[str, list[float]] = {way: [] for way in ways}
    for turn in range(options.rounds + 1):
        for way, renders in ways.items():
            spent = sum(processor_seconds("render", scene, "-o", folder / f"{turn}-{way[-1]}", *r) for r in renders)
            seconds[way] += [spent] if turn else []
    print("| | over one process |\n|---|---:|")
    for way in list(ways)[1:]:
        ratios = np.array(seconds[way]) / np.array(seconds["one process"])
        value = interval(lambda k, r=ratios: np.array(np.median(r[k])), options.rounds)
        print(f"| `{way}` | {shown(value)} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["kills", "costs"])
    for name, default in (("count", 50), ("seed", 1), ("size", 96), ("rounds", 5)):
        parser.add_argument(f"--{name}", type=int, default=default)
    options = parser.parse_args()
    mi.set_variant("llvm_ad_rgb")
    with tempfile.TemporaryDirectory() as name:
        {"kills": kills, "costs": costs}[options.what](Path(name), options)


if __name__ == "__main__":
    main()
