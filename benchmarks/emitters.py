"""Time of each light source beside Mitsuba's own.

    python benchmarks/emitters.py [--variant llvm_ad_rgb] [--size 192] [--spp 32] [--rounds 9]

A diffuse ball on a diffuse floor, one integrator (``path``), one sampler; both are rendered warm and by turns, so that
a machine that is busy or slows down does the same to both. Printed are the median time of ours, the median over the
turns of the quotient of the times, ours / theirs, and the quotient of the variances (of a pixel among renderings,
averaged over the image and divided by the squared mean). Mitsuba has no cone and no cos^n: its ``spot`` stands beside
ours, its ``area`` beside a sphere with a beam.
"""

import mitsuba as mi
from turns import arguments, ball_on_a_floor, compare

PLACE = [2, 4, 2]
CONE = {"distribution": "cone", "direction": [-1, -2, -1], "angle": 25.0}
SPOT = {"distribution": "spot", "direction": [-1, -2, -1], "exponent": 8.0}


def sphere(emitter):
    return {"type": "sphere", "center": PLACE, "radius": 0.5, "emitter": emitter}


def point(plugin, **parameters):
    return {"type": plugin, "position": PLACE, "intensity": 15.0, **parameters}


def area(plugin, **parameters):
    return sphere({"type": plugin, "radiance": 20.0, **parameters})


def pairs():
    spot = {
        "type": "spot",
        "intensity": 15.0,
        "cutoff_angle": 25.0,
        "to_world": mi.ScalarTransform4f().look_at(PLACE, [1, 2, 1], [0, 0, 1]),
    }
    return {
        "point": (point("prosim_point"), point("point")),
        "point, cone": (point("prosim_point", **CONE), spot),
        "point, spot": (point("prosim_point", **SPOT), spot),
        "point, unattenuated": (point("prosim_point", unattenuated=True), point("point")),
        "sphere": (area("prosim_area"), area("area")),
        "sphere, cone": (area("prosim_area", **CONE), area("area")),
        "sphere, spot": (area("prosim_area", **SPOT), area("area")),
        "sphere, unattenuated": (area("prosim_area", unattenuated=True), area("area")),
    }


def scene(source, size, spp):
    return ball_on_a_floor(size, spp, 4, {}, {"source": source})


def main():
    options = arguments(__doc__.split("\n")[0]).parse_args()
    mi.set_variant(options.variant)
    import mitsuba_prosim  # noqa: F401

    print(f"{'source':26}{'time ms':>9}{'time ratio':>12}{'variance ratio':>16}")
    for name, (ours, theirs) in pairs().items():
        seconds, speed, variance = compare(
            *(scene(x, options.size, options.spp) for x in (ours, theirs)), options.rounds
        )
        print(f"{name:26}{1e3 * seconds:9.0f}{speed:12.2f}{variance:16.2f}", flush=True)


if __name__ == "__main__":
    main()
