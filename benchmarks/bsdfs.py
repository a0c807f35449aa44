"""Time and variance per sample of each material beside the nearest one of Mitsuba's own.

    python benchmarks/bsdfs.py [--variant llvm_ad_rgb] [--size 192] [--spp 32] [--rounds 9]

One scene (a ball and a floor of the material, a spherical light, a dim sky), one integrator (``path``), one sampler;
both are rendered warm and by turns, so that a machine that is busy or slows down does the same to both. Printed are
the quotients ours / theirs: the median over the turns of that of the times, and that of the variances (of a pixel
among renderings, averaged over the image and divided by the squared mean, for the two models are not equally bright:
ours have the G of V-cavities, Mitsuba's have Smith's; Phong's lobe and roughplastic are only akin).
"""

import mitsuba as mi
from turns import arguments, ball_on_a_floor, compare

PAIRS = {
    "lambertian": ({"type": "prosim_lambertian"}, {"type": "diffuse"}),
    "conductor, smooth": ({"type": "prosim_conductor", "material": "Cu"}, {"type": "conductor", "material": "Cu"}),
    "conductor, 0.1": (
        {"type": "prosim_conductor", "material": "Cu", "alpha": 0.1},
        {"type": "roughconductor", "material": "Cu", "alpha": 0.1},
    ),
    "conductor, 0.4": (
        {"type": "prosim_conductor", "material": "Cu", "alpha": 0.4},
        {"type": "roughconductor", "material": "Cu", "alpha": 0.4},
    ),
    "conductor, exponent 50": (
        {"type": "prosim_conductor", "material": "Cu", "exponent": 50.0},
        {"type": "roughconductor", "material": "Cu", "alpha": 0.196},
    ),
    "conductor, gaussian 0.1": (
        {"type": "prosim_conductor", "material": "Cu", "alpha": 0.1, "distribution": "gaussian"},
        {"type": "roughconductor", "material": "Cu", "alpha": 0.1},
    ),
    "dielectric, smooth": ({"type": "prosim_dielectric"}, {"type": "dielectric"}),
    "dielectric, 0.1": ({"type": "prosim_dielectric", "alpha": 0.1}, {"type": "roughdielectric", "alpha": 0.1}),
    "composite, smooth": (
        {"type": "prosim_composite", "diffuse_reflectance": 0.4},
        {"type": "plastic", "diffuse_reflectance": 0.4},
    ),
    "composite, 0.1": (
        {"type": "prosim_composite", "diffuse_reflectance": 0.4, "alpha": 0.1},
        {"type": "roughplastic", "diffuse_reflectance": 0.4, "alpha": 0.1},
    ),
    "phong, exponent 50": ({"type": "prosim_phong", "exponent": 50.0}, {"type": "roughplastic", "alpha": 0.1}),
}


def scene(bsdf, size, spp):
    others = {
        "material": bsdf | {"id": "material"},
        "lamp": {"type": "sphere", "center": [2, 4, 2], "radius": 0.5, "emitter": {"type": "area", "radiance": 20.0}},
        "sky": {"type": "constant", "radiance": 0.3},
    }
    return ball_on_a_floor(size, spp, 6, {"bsdf": {"type": "ref", "id": "material"}}, others)


def main():
    parser = arguments(__doc__.split("\n")[0])
    parser.add_argument("--only", default="", help="part of a row's name")
    options = parser.parse_args()
    mi.set_variant(options.variant)
    import mitsuba_prosim  # noqa: F401

    print(f"{'material':26}{'time ms':>9}{'time ratio':>12}{'variance ratio':>16}   beside")
    for name, (ours, theirs) in PAIRS.items():
        if options.only in name:
            seconds, speed, variance = compare(
                *(scene(x, options.size, options.spp) for x in (ours, theirs)), options.rounds
            )
            print(f"{name:26}{1e3 * seconds:9.0f}{speed:12.2f}{variance:16.2f}   {theirs['type']}", flush=True)


if __name__ == "__main__":
    main()
