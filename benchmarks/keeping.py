"""What keeping an image costs, how much is lost by a kill, and how much memory it takes.

    python benchmarks/keeping.py [--width 1600] [--height 1600] [--samples 8] [--filter box] [--scene palito] [--bare]

Renders a scene with ``adaptive = none`` (or to ``--noise``) and keeps its state, as ``prosim render --keep`` does. The
cost is the processor time of copying and writing states, over all of the process's; the age is what a kill at the worst
moment would have lost: the seconds from when what is on the disk was true, to when the next was there; and that of the
first, from the first sample on. ``--bare`` keeps nothing: for the memory and the time without.
"""

from __future__ import annotations

import argparse
import itertools
import resource
import tempfile
import time
from pathlib import Path
from typing import Any

EXAMPLES = Path(__file__).parents[1] / "examples"


def most() -> int:
    """The most memory that this process had so far, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


def measured(keeper_class: type) -> type:
    """A keeper that notes when what it has written was true and when it was there, and its processor time."""

    class Measured(keeper_class):  # type: ignore[misc, valid-type]
        cpu = 0.0

        def __call__(self, render: Any, last: bool = False) -> None:
            self.moments: list[tuple[float, float]] = getattr(self, "moments", [])
            self.longest = max(getattr(self, "longest", 0.0), time.perf_counter() - getattr(self, "asked", 1e9))
            start = time.thread_time()
            super().__call__(render, last)
            self.cpu += time.thread_time() - start
            self.asked = time.perf_counter()

        def _write(self, record: Any, begun: float, *others: Any) -> None:
            start = time.thread_time()
            super()._write(record, begun, *others)
            self.cpu += time.thread_time() - start
            self.moments.append((begun, time.perf_counter()))

    return Measured


def measure(asked: argparse.Namespace) -> None:
    import mitsuba as mi
    import prosim_scene
    from mitsuba_prosim.saved.keeper import Keeper
    from mitsuba_prosim.scene import rendering

    integrator = {"adaptive": "none"} if not asked.noise else {"noise": asked.noise}
    with tempfile.TemporaryDirectory(dir=asked.folder) as name:
        folder, size = Path(name), (asked.width, asked.height)
        made = prosim_scene.load(EXAMPLES / f"{asked.scene}.scn", resolution=size, samples=asked.samples)
        made["integrator"] |= integrator
        made["view"]["film"]["filter"] = {"type": asked.filter}
        scene = mi.load_dict(made)
        sensor = scene.sensors()[0]
        print(f"{asked.scene}, {size[0]} x {size[1]}, {asked.samples**2} samples, {asked.filter}", flush=True)
        before, start, used = most(), time.perf_counter(), time.process_time()
        keeper = None if asked.bare else measured(Keeper)(folder / "a.state.exr", {}, print)
        first: list[float] = []
        render = rendering.progressive(scene, sensor)
        for _ in render:
            first.append(time.perf_counter())
            if keeper is not None:
                keeper(render)
        if keeper is not None:
            keeper(render, True)
        seconds, used = time.perf_counter() - start, time.process_time() - used
        print(f"{seconds:.1f} s, {used:.1f} s of the processors; {before} MB before, {most()} MB at most")
        if keeper is not None:
            moments, disk = keeper.moments, (folder / "a.state.exr").stat().st_size
            ages = [end - then for (then, _), (_, end) in itertools.pairwise(moments)]
            print(
                f"state of {disk / 1e6:.0f} MB, written {len(moments)} times, the longest in "
                f"{max(end - begun for begun, end in moments):.2f} s; {keeper.cpu:.2f} s of the processors, "
                f"{100 * keeper.cpu / used:.1f} %; longest portion {keeper.longest:.1f} s; the first after "
                f"{moments[0][1] - start:.1f} s (the first portion after {first[0] - start:.1f} s), then "
                f"at most {max(ages, default=0):.1f} s are lost"
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in (("width", 1600), ("height", 1600), ("samples", 8)):
        parser.add_argument(f"--{name}", type=int, default=default)
    for name, default in (("filter", "box"), ("scene", "palito"), ("folder", None)):
        parser.add_argument(f"--{name}", default=default)
    parser.add_argument("--noise", type=float, default=0.0)
    parser.add_argument("--bare", action="store_true")
    asked = parser.parse_args()

    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    import mitsuba_prosim  # noqa: F401  (registers the plugins)

    measure(asked)
