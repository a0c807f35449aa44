"""What kills do to an image: nothing.

    python benchmarks/faults.py [--renders 50] [--workers 50] [--parts 16] [--seed 1] [--size 96]

``--renders``: so many times the whole render is killed (``SIGKILL``, at a random moment) and gone on with, by all
policies and filters in turn. ``--workers``: so many times a random worker of two or three is, once the cluster is
there. ``--parts``: the image is put together from 1, 2, ... so many parts, in any order. After each the bytes are
compared with those of an undisturbed render, and the process ends with an error where they differ. States are written
more often than usual, so that short renders have some to go on with.
"""

from __future__ import annotations

import argparse
import itertools
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import psutil

SCENE = """<scene version="3.0.0">
    <integrator type="prosim_adaptive"><integrator type="path"/><integer name="band" value="2000"/></integrator>
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

#: Options of the command by policy: renders of some seconds, on which noise is pursued as well.
POLICIES = {
    "none": ["--adaptive", "none", "--samples", "40"],
    "thesis": ["--adaptive", "thesis", "--samples", "40", "--threshold", "0.002"],
    "neighbours": ["--adaptive", "neighbours", "--samples", "40", "--threshold", "0.002"],
    "graded": ["--adaptive", "graded", "--samples", "20", "--threshold", "0.002"],
    "graded to a noise": ["--adaptive", "graded", "--noise", "0.002"],
}
FILTERS = ("box", "gaussian")

#: ``prosim`` that writes its state after each portion, which takes a fifth of a second.
HURRIED = (
    "from mitsuba_prosim.saved.keeper import Keeper; from mitsuba_prosim.engine.pace import Pace; "
    "Keeper.SHORTEST, Keeper.TIMES, Keeper.SHARE = 0, 0, 1e9; Pace.SHORTEST, Pace.LONGEST = 0.1, 0.4; "
    "from prosim_start import main; main()"
)


class Render:
    """``prosim`` in a process of its own."""

    def __init__(self, *arguments: object) -> None:
        command = [sys.executable, "-c", HURRIED, *map(str, arguments)]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    def ends_within(self, seconds: float | None) -> bool:
        """Whether it ended by itself; what it said is an error where it was not well."""
        try:
            said, _ = self.process.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            return False
        if self.process.returncode:
            raise SystemExit(f"it ended with {self.process.returncode}:\n{said}")
        return True

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def workers(self) -> list[psutil.Process]:
        """The processes of its workers, as far as they are there."""
        try:
            return [p for p in psutil.Process(self.process.pid).children() if "spawn_main" in " ".join(p.cmdline())]
        except psutil.Error:
            return []


def content(stem: Path) -> tuple[bytes, bytes]:
    """The PNG, and the values of the EXR, whose metadata say how long it took."""
    return stem.with_suffix(".png").read_bytes(), np.array(mi.Bitmap(str(stem.with_suffix(".exr")))).tobytes()


def scene(folder: Path, rfilter: str, size: int) -> Path:
    path = folder / f"{rfilter}.xml"
    path.write_text(SCENE.format(size=size, rfilter=rfilter))
    return path


def undisturbed(folder: Path, size: int) -> Iterator[tuple[str, str, Path, list[str], tuple[bytes, bytes], float]]:
    """``(policy, filter, scene, options, content, seconds)``, again and again."""
    known: dict[tuple[str, str], tuple[tuple[bytes, bytes], float]] = {}
    for policy, rfilter in itertools.cycle(itertools.product(POLICIES, FILTERS)):
        path, stem = scene(folder, rfilter, size), folder / f"whole-{policy}-{rfilter}".replace(" ", "-")
        if (policy, rfilter) not in known:
            start = time.perf_counter()
            Render("render", path, "-o", stem, *POLICIES[policy]).ends_within(None)
            known[policy, rfilter] = content(stem), time.perf_counter() - start
        yield policy, rfilter, path, POLICIES[policy], *known[policy, rfilter]


def shared(number: int) -> int:
    """How often one image is disturbed at most, so that all policies and filters have their share."""
    return -(-number // (len(POLICIES) * len(FILTERS)))


def check(mine: tuple[bytes, bytes], theirs: tuple[bytes, bytes], what: str) -> None:
    if mine != theirs:
        raise SystemExit(f"{what}: the bytes are others")
    print(f"{what}: the same bytes", flush=True)


def kill_renders(number: int, folder: Path, size: int, chance: random.Random) -> None:
    killed, without, each = 0, 0, shared(number)
    for n, (policy, rfilter, path, options, whole, seconds) in enumerate(undisturbed(folder, size)):
        if killed >= number:
            break
        stem, here = folder / f"killed-{n}", 0
        state = stem.with_name(stem.name + ".state.exr")
        while True:
            begun = state.exists()
            render = Render("resume", state) if begun else Render("render", path, "--keep", "-o", stem, *options)
            if render.ends_within(None if here >= each else chance.uniform(0.5, 0.9 * seconds)):
                break
            render.kill()
            here, without = here + 1, without + (not state.exists())
        killed += here
        check(content(stem), whole, f"{policy}, {rfilter}: killed {here} times, {killed} in all")
        for left in folder.glob(f"killed-{n}*"):
            left.unlink()
    print(f"{killed} renders were killed, {without} of them before there was a state", flush=True)


def kill_workers(number: int, folder: Path, size: int, chance: random.Random) -> None:
    killed, each = 0, shared(number)
    for n, (policy, rfilter, path, options, whole, _) in enumerate(undisturbed(folder, size)):
        if killed >= number:
            break
        stem, here, workers = folder / f"lost-{n}", 0, 2 + n % 2
        render = Render("render", path, "-o", stem, "--keep", "--workers", workers, *options)
        while not render.ends_within(None if here >= each else chance.uniform(0.2, 3)):
            # Before, the cluster is being set up, which Dask does not begin twice.
            if stem.with_name(stem.name + ".state.exr").exists() and (there := render.workers()):
                try:
                    chance.choice(there).kill()
                    here += 1
                except psutil.Error:
                    pass
        killed += here
        check(content(stem), whole, f"{policy}, {rfilter}: {here} of {workers} workers killed, {killed} in all")
    print(f"{killed} workers were killed", flush=True)


def put_parts_together(most: int, folder: Path, size: int, chance: random.Random) -> None:
    from mitsuba_prosim import saved
    from mitsuba_prosim.engine.part import Part

    for policy, rfilter in itertools.product(("none", "thesis", "neighbours", "graded"), FILTERS):
        loaded: Any = mi.load_file(str(scene(folder, rfilter, size)))
        integrator = loaded.integrator()
        integrator.adaptive, integrator.samples, integrator.threshold = policy, 4, 0.01
        whole = np.array(integrator.render(loaded, seed=1)).tobytes()
        for of in range(1, most + 1):
            paths = [folder / f"part.{number}-of-{of}.exr" for number in range(1, of + 1)]
            for number, path in enumerate(paths, 1):
                part = integrator.progressive(loaded, seed=1, part=Part(number, of)).run()
                saved.save(part.checkpoint(), path)
            chance.shuffle(paths)
            last = integrator.progressive(loaded, seed=1, begin=saved.merge(paths)).run()
            if np.array(last.image()).tobytes() != whole:
                raise SystemExit(f"{policy}, {rfilter}, {of} parts: the bytes are others")
        print(f"{policy}, {rfilter}: the same bytes from 1 to {most} parts", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in (("renders", 50), ("workers", 50), ("parts", 16), ("seed", 1), ("size", 96)):
        parser.add_argument(f"--{name}", type=int, default=default)
    asked = parser.parse_args()
    mi.set_variant("llvm_ad_rgb")
    import mitsuba_prosim  # noqa: F401  (registers the plugins)

    with tempfile.TemporaryDirectory() as name:
        folder, chance = Path(name), random.Random(asked.seed)
        for number, act in (
            (asked.renders, kill_renders),
            (asked.workers, kill_workers),
            (asked.parts, put_parts_together),
        ):
            start = time.perf_counter()
            act(number, folder, asked.size, chance)
            print(f"{time.perf_counter() - start:.0f} s", flush=True)
