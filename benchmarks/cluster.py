"""What a cluster costs: workers of one thread against one process of as many, and a model for more of them.

    python benchmarks/cluster.py [--size 1600] [--samples 8] [--workers 2] [--rounds 2] [--memory 2000]
    python benchmarks/cluster.py --model
    python benchmarks/cluster.py --photons 500 [--noise 0.0025] [--workers 2]

Both render ``palito`` with ``adaptive = none``, in turn, each after a small image that compiles the kernels; the least
time of the rounds counts, and beside it the time of the processors, which says more where a machine has other things to
do. "portions" is the time that the workers were busy, over their number, against the time of one process. "start" is
the time from the beginning of a new worker's process to its first finished portion, its kernels being on the disk.
As it stands, with 1600 x 1600 pixels and 64 samples, that is about five minutes and a half on two cores.
``--memory``: the most memory of the process that gathers an image of that side, and its processor time, for each pixel
and for each portion.
``--model`` prints the table alone, of constants that were measured. ``--photons``: ``copo``, which has caustics, with
that side: the time of the processors, and what drawing photons takes of it.
"""

from __future__ import annotations

import argparse
import os
import resource
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

PALITO, COPO = (Path(__file__).parents[1] / "examples" / name for name in ("palito.scn", "copo.scn"))


def opened(size: int, n: int, folder: str) -> Any:
    """``palito``, ``n``² samples in each of ``size``² pixels."""
    from mitsuba_prosim.scene import scene_file

    integrator = {"adaptive": "none"}
    return scene_file.SceneFile(PALITO, folder, resolution=(size, size), samples=n, integrator=integrator)


def timed(scene: Any, processes: list[Any], executor: Any = None) -> tuple[float, float]:
    """``(seconds, seconds of the processors)`` of rendering a scene, by these processes, as the command does it."""
    from mitsuba_prosim.scene import rendering

    before, start = sum(sum(p.cpu_times()[:2]) for p in processes), time.perf_counter()
    for _ in rendering.progressive(scene, scene.sensors()[0], seed=1, executor=executor):
        pass
    return time.perf_counter() - start, sum(sum(p.cpu_times()[:2]) for p in processes) - before


def measure(size: int, n: int, workers: int, rounds: int) -> None:
    """Both, in turn."""
    import drjit as dr
    import psutil
    from mitsuba_prosim.cluster import Remote, local
    from mitsuba_prosim.cluster.parcel import Parcel
    from mitsuba_prosim.scene import atomic

    dr.set_thread_count(workers)
    with local.workers(workers, workers) as client, atomic.scratch() as folder:
        small = opened(64, n, str(folder))
        first, parcel = small.load(), Parcel.of(small)
        file = opened(size, n, str(folder))  # whose translation takes the place of the other
        scene = file.load()
        start = time.perf_counter()
        with Remote(client, parcel) as taker:
            first.integrator().progressive(first, seed=1, executor=taker).run()
        print(f"workers that are there, until the first small image is done: {time.perf_counter() - start:.1f} s")
        first.integrator().render(first, seed=1)
        here = [psutil.Process()]
        there = here + [psutil.Process(pid) for pid in client.run(os.getpid).values()]
        alone, together, busy = [], [], []
        with Remote(client, Parcel.of(file)) as taker:
            for _ in range(rounds):
                alone.append(timed(scene, here))
                done, took = taker.portions, taker.busy
                together.append(timed(scene, there, taker))
                busy.append((taker.busy - took) / workers)
                print(
                    f"{size} x {size}, {n * n} samples: one process {alone[-1][0]:.2f} s ({alone[-1][1]:.2f} of the "
                    f"processors), {workers} workers {together[-1][0]:.2f} s ({together[-1][1]:.2f}), "
                    f"{taker.portions - done} portions, {busy[-1]:.2f} s each worker",
                    flush=True,
                )
        one, cpu = min(alone), min(used for _, used in alone)
        print(
            f"ratio {min(together)[0] / one[0]:.3f}, of the processors {min(used for _, used in together) / cpu:.3f}, "
            f"portions {min(busy) / one[0]:.3f}"
        )


def new_worker() -> None:
    """From the beginning of a worker's process to its first finished portion."""
    from mitsuba_prosim.cluster import Remote, local
    from mitsuba_prosim.cluster.parcel import Parcel
    from mitsuba_prosim.scene import atomic

    with atomic.scratch() as folder:
        small = opened(64, 2, str(folder))
        scene, parcel = small.load(), Parcel.of(small)
        start = time.perf_counter()
        with local.workers(1, 1) as client, Remote(client, parcel) as taker:
            process = time.perf_counter() - start
            render = scene.integrator().progressive(scene, seed=1, executor=taker)
            finished = [time.perf_counter() - start for _ in render]
    print(
        f"start of a worker: {process:.1f} s its process and Dask, {finished[0]:.1f} s until its first portion is done"
    )


def memory(size: int, workers: int) -> None:
    """The most memory of this process while it gathers, and its processor time."""
    import drjit as dr
    from mitsuba_prosim.cluster import Remote, local
    from mitsuba_prosim.cluster.parcel import Parcel
    from mitsuba_prosim.scene import atomic

    class Small(Remote):
        def limit(self, most: int | None, left: int) -> int | None:
            return 16

    def most() -> int:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024

    dr.set_thread_count(workers)
    with local.workers(workers, workers) as client, atomic.scratch() as folder:
        file = opened(size, 1, str(folder))
        scene = file.load()
        with Remote(client, Parcel.of(file)) as taker:
            before, start = most(), time.process_time()
            render = scene.integrator().progressive(scene, seed=1, executor=taker)
            for _ in render:
                gathered, took = most(), time.process_time() - start
            values = 5 + len(render.state.estimate.sums)
            print(
                f"{size} x {size}: {before} MB before, {gathered} MB at most while gathering, of which the state has "
                f"{4 * values * size * size / 1e6:.0f} MB ({values} values a pixel); with the film {most()} MB; "
                f"{took:.2f} s of the processors, {taker.portions} portions"
            )
        file = opened(64, 1, str(folder))
        scene = file.load()
        with Small(client, Parcel.of(file)) as taker:
            start = time.process_time()
            scene.integrator().progressive(scene, seed=1, executor=taker).run()
            took = time.process_time() - start
            print(
                f"{took / taker.portions * 1000:.1f} ms of the processors for each of {taker.portions} small portions"
            )


def photons(size: int, noise: float, workers: int) -> None:
    """An image with caustics, by one process and by workers: who draws how many sets of photons."""
    import drjit as dr
    import psutil
    from mitsuba_prosim.cluster import Remote, local, worker
    from mitsuba_prosim.cluster.parcel import Parcel
    from mitsuba_prosim.scene import atomic, scene_file

    def used(processes: list[Any]) -> float:
        return sum(sum(p.cpu_times()[:2]) for p in processes)

    def drawn() -> tuple[int, float]:
        caustics = [one.estimator.transport.caustics for one in worker.scenes.values() if one.estimator]
        return sum(one.draws for one in caustics), sum(one.seconds for one in caustics)

    dr.set_thread_count(workers)
    here = [psutil.Process()]
    with atomic.scratch() as folder, local.workers(workers, workers) as client:
        size_of_image = size, round(1.2 * size)
        file = scene_file.SceneFile(COPO, folder, resolution=size_of_image, integrator={"noise": noise})
        scene = file.load()
        before = used(here)
        caustics = scene.integrator().progressive(scene, seed=1).run().state.estimator.transport.caustics
        print(
            f"one process: {used(here) - before:.1f} s of the processors; {caustics.draws} sets of photons, in "
            f"{caustics.seconds:.1f} s by the clock",
            flush=True,
        )
        there = here + [psutil.Process(pid) for pid in client.run(os.getpid).values()]
        before = used(there)
        with Remote(client, Parcel.of(file)) as taker:
            scene.integrator().progressive(scene, seed=1, executor=taker).run()
        sets = ", ".join(f"{number} in {seconds:.1f} s" for number, seconds in client.run(drawn).values())
        print(f"{workers} workers: {used(there) - before:.1f} s; sets of each: {sets}; {taker.portions} portions")


# ------------------------------------------------------------------ more workers than there are here


@dataclass(frozen=True)
class Constants:
    """What was measured: seconds, if nothing else is said."""

    #: Of a worker until it has the scene and its kernels, from a warm disk.
    start: float = 3.0
    #: Samples in a second of a worker, of one thread.
    pace: float = 1.1e6
    #: Before each portion.
    before: float = 0.06
    #: Of the process that gathers: for each portion, and for each pixel that has 9 values (a box filter).
    portion: float = 0.014
    pixel: float = 3e-7
    #: From the end of a wave to the first portion of the next.
    wave: float = 0.1


def modelled(workers: int, pixels: int, samples: float, waves: int = 1, c: Constants = Constants()) -> float:
    """Seconds that so many workers take: the longer of what they do and of what one process hands out and gathers."""
    from mitsuba_prosim.cluster.fleet import LONGEST, MANY, SHORTEST

    each = pixels * samples / (workers * c.pace)
    seconds = max(min(LONGEST * max(1, workers / MANY), each / 2), SHORTEST)
    portions = max(each / seconds, 1)
    working = each + portions * c.before + waves * (c.wave + seconds / 4)
    gathering = workers * portions * c.portion + waves * pixels * c.pixel
    return c.start + max(working, gathering)


def table() -> None:
    """For images of three sizes."""
    images = [
        ("1600², 64", 1600**2, 64),
        ("3840 × 2160, 256", 3840 * 2160, 256),
        ("7680 × 4320, 1024", 7680 * 4320, 1024),
    ]
    print("| workers | " + " | ".join(name for name, *_ in images) + " |")
    for workers in (1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1000):
        times = [modelled(workers, pixels, samples) for _, pixels, samples in images]
        print(f"| {workers} | " + " | ".join(f"{t:,.0f} s" if t >= 10 else f"{t:.1f} s" for t in times) + " |")
    for name, pixels, samples in images:
        pays = next(k for k in range(1, 10**4) if modelled(2 * k, pixels, samples) > 0.9 * modelled(k, pixels, samples))
        print(f"{name}: twice as many workers gain less than a tenth from {pays} on")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in (("size", 1600), ("samples", 8), ("workers", 2), ("rounds", 2), ("memory", 0), ("photons", 0)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--noise", type=float, default=0.0025)
    parser.add_argument("--model", action="store_true")
    asked = parser.parse_args()
    if not asked.model:
        import mitsuba as mi

        mi.set_variant("llvm_ad_rgb")
        import mitsuba_prosim  # noqa: F401  (registers the plugins)

        if asked.memory:
            memory(asked.memory, asked.workers)
        elif asked.photons:
            photons(asked.photons, asked.noise, asked.workers)
        else:
            new_worker()
            measure(asked.size, asked.samples, asked.workers, asked.rounds)
    if not asked.photons:
        table()
