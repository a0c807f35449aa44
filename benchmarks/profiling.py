"""Where the time goes in the prosim integrator: compilation, launches, Python; memory; rays a second.

    python benchmarks/profiling.py [--scene penumbra copper palito] [--size 500] [--large 7680x4320]

Each figure comes from processes of their own. "cold": first render with Dr.Jit's kernel cache empty; "cached": first
render of a second process, which finds the kernels on disk; "warm": median of further renders. "overhead" is the part
of the warm time in which no kernel ran. "compiled again" counts kernels that another seed, another size of bands,
another resolution, a crop window or an override of the sample count made Dr.Jit compile: 0 is right. "rays" is camera
rays and shadow rays to every source, for scenes without reflected rays; "bare" is what ``scene.ray_test`` does alone,
on shadow rays of the same scene. ``--large`` renders the first scene at that size and reports the most memory the
process had.
"""

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time


def seconds(action):
    start = time.perf_counter()
    result = action()
    return time.perf_counter() - start, result


def memory():
    """Peak of the memory of this process in MB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1 << 20 if sys.platform == "darwin" else 1 << 10)


def probe(name, width, height, only_first):
    """Profiles one scene in this process."""
    import drjit as dr
    import mitsuba as mi
    import mitsuba_prosim  # noqa: F401  (registers the plugins)
    import numpy as np

    mi.set_variant("llvm_ad_rgb")
    mi.set_log_level(mi.LogLevel.Error)
    from mitsuba_prosim.compare.scenes import Spec
    from scenes import SCENES

    case = SCENES[name]
    with tempfile.TemporaryDirectory() as folder:
        opened = case.open(width, folder)
        contestant = opened.contestant(Spec("prosim"), case.transports[0])
    scene, integrator = contestant.scene, contestant.integrator
    sensor = scene.sensors()[0]

    def resize(w, h, crop=None):
        film = mi.traverse(sensor)
        film["film.size"] = mi.ScalarVector2u(w, h)
        film["film.crop_size"] = mi.ScalarVector2u(*(crop or (w, h)))
        film["film.crop_offset"] = mi.ScalarPoint2u(0)
        film.update()

    def render(seed=0, spp=0):
        image = integrator.render(scene, sensor, seed=seed, spp=spp)
        dr.eval(image)
        dr.sync_thread()

    def history(action):
        """Entries of the kernel history while ``action`` runs, the wall-clock seconds."""
        dr.kernel_history_clear()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            wall, _ = seconds(action)
        return dr.kernel_history(), wall

    resize(width, height)
    before = memory()
    entries, first = history(render)
    jit = [e for e in entries if e["type"] == dr.KernelType.JIT]
    result = {
        "first": first,
        "kernels": len(jit),
        "memory_before": before,
        "memory": memory(),
        "codegen": sum(e["codegen_time"] for e in jit) / 1e3,
        "backend": sum(e["backend_time"] for e in jit) / 1e3,
    }
    if only_first:
        return result

    render()
    result["warm"] = statistics.median(seconds(render)[0] for _ in range(9))
    launches, running = [], []
    for _ in range(5):
        entries, wall = history(render)
        launches.append(len(entries))
        running.append(sum(e["execution_time"] for e in entries) / 1e3 / wall)
    result["launches"] = launches[-1]
    result["overhead"] = 1 - statistics.median(running)

    def compiled(action):
        return sum(e["type"] == dr.KernelType.JIT and not e["cache_hit"] for e in history(action)[0])

    integrator.band, whole = width * 40, integrator.band
    again = {"band": compiled(render)}
    integrator.band = whole
    again["seed"] = compiled(lambda: render(seed=7))
    integrator.threshold *= 0.7
    again["threshold"] = compiled(render)
    resize(width + 12, height + 8)
    again["resolution"] = compiled(render)
    resize(width, height, (width // 2, height // 3))
    again["crop"] = compiled(render)
    resize(width, height)
    again["samples"] = compiled(lambda: render(spp=49))
    result["compiled_again"] = again

    # The bare throughput, on shadow rays from what the camera sees to a point of the first source.
    samples = float(contestant.counts().sum())
    sampler = sensor.sampler().clone()
    sampler.seed(0, 1 << 21)
    ray, _ = sensor.sample_ray(0, 0.5, sampler.next_2d(), mi.Point2f(0.5))
    si = scene.ray_intersect(ray)
    emitter = scene.emitters()[0]
    ds, _ = emitter.sample_direction(si, sampler.next_2d(), si.is_valid())
    shadow = si.spawn_ray_to(ds.p)
    valid = si.is_valid()
    dr.eval(shadow, valid)
    dr.eval(ray)

    def bare(rays, valid=True):
        blocked = scene.ray_test(rays, valid)
        dr.eval(blocked)
        dr.sync_thread()

    bare(shadow, valid)
    number = float(np.count_nonzero(np.array(valid)))
    result["bare"] = number / statistics.median(seconds(lambda: bare(shadow, valid))[0] for _ in range(9))
    # By turns with the renders, so that the ratio means something on a busy machine.
    again = statistics.median(seconds(render)[0] for _ in range(9))
    result["samples"] = samples / again
    result["rays"] = samples * (1 + len(scene.emitters())) / again if integrator.max_level == 0 else None
    return result


def in_process(home, *arguments):
    """The result of :func:`probe` in another process, whose home folder holds Dr.Jit's kernel cache."""
    # LIBLLVM is named by a start-up file, which does not depend on the home folder.
    run = subprocess.run(
        [sys.executable, __file__, "--probe", *map(str, arguments)],
        env=os.environ | {"HOME": home},
        check=False,
        capture_output=True,
        text=True,
    )
    if run.returncode:
        sys.exit(run.stderr)
    return json.loads(run.stdout.splitlines()[-1])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", nargs="+", default=["penumbra", "copper", "palito"])
    parser.add_argument("--size", type=int, default=500)
    parser.add_argument("--large", metavar="WxH")
    parser.add_argument("--probe", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.probe:
        name, width, height, only_first = options.probe
        print(json.dumps(probe(name, int(width), int(height), only_first == "True")))
        return
    print(f"{options.size} x {options.size}, N = 5, adaptive = neighbours\n")
    print(
        "| | cold s | of it code generation, LLVM | cached s | warm s | launches | overhead | Msamples/s | Mrays/s | "
        "bare Mrays/s | MB before, after |"
    )
    print("|---|" + "---:|" * 10)
    results = {}
    for name in options.scene:
        with tempfile.TemporaryDirectory() as home:
            cold = in_process(home, name, options.size, options.size, True)
            r = results[name] = in_process(home, name, options.size, options.size, False)
        rays = f"{r['rays'] / 1e6:.1f}" if r["rays"] else ""
        print(
            f"| {name} | {cold['first']:.2f} | {cold['codegen']:.2f}, {cold['backend']:.2f} | {r['first']:.2f} | "
            f"{r['warm']:.3f} | {r['launches']} | {r['overhead']:.1%} | {r['samples'] / 1e6:.1f} | {rays} | "
            f"{r['bare'] / 1e6:.1f} | {cold['memory_before']:.0f}, {cold['memory']:.0f} |",
            flush=True,
        )
    print("\nKernels compiled again:")
    for name, r in results.items():
        print(f"- {name}: " + ", ".join(f"{what} {count}" for what, count in r["compiled_again"].items()))
    if options.large:
        width, height = map(int, options.large.split("x"))
        with tempfile.TemporaryDirectory() as home:
            r = in_process(home, options.scene[0], width, height, True)
        image = width * height * 3 * 4 / (1 << 20)
        print(
            f"\n{options.scene[0]} at {width} x {height}: {r['first']:.1f} s, at most {r['memory']:.0f} MB, of which "
            f"{r['memory_before']:.0f} MB before rendering and {image:.0f} MB are the image"
        )


if __name__ == "__main__":
    main()
