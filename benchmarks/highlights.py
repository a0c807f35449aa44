"""The highlights of smooth things as rough metal sees them: by the rays of its lobe alone, and shared with photons.

    python benchmarks/highlights.py [--size 64] [--images 6] [--photons 131072] [--pictures folder]

A copper plate (Beckmann, m = 0.2 to 0.4) beside a ball, smooth or nearly so, that mirrors or refracts a small lamp;
everything is rendered side by side, without ``caustics`` and with them, at the same number of samples, 25. Printed are
percentiles of the error of all pixels of some images, absolute, the largest of r, g and b, against a converged image
(ours, with ``caustics``: that it is right is shown by the tests, against ``path``); with over without; and the
processor seconds of an image.
"""

import argparse
import time
from pathlib import Path

import mitsuba as mi
import numpy as np
from PIL import Image
from scenes import ball, camera, diffuse, floor, rgb

PERCENTILES = (90, 99, 99.9)
MIRROR = {"type": "conductor", "material": "none"}
GLASS = {"type": "dielectric"}
ENAMEL = {"type": "prosim_composite", "diffuse_reflectance": rgb(0, 0, 0), "int_ior": 1.5}
PHONG = {"type": "prosim_phong", "diffuse_reflectance": rgb(0, 0, 0), "specular_reflectance": 0.9}


def silver(m):
    """Nearly smooth metal."""
    return {"type": "prosim_conductor", "material": "Ag", "alpha": m}


def frosted(m):
    """Nearly smooth glass."""
    return {"type": "prosim_dielectric", "int_ior": 1.5, "alpha": m}


def lamp(radius, distribution):
    """A sphere that lights as much whatever its size, on its axis if it has one."""
    emitter = {"type": "prosim_area", "radiance": 7.5 / radius**2} | distribution
    return ball([-2, 3, 1], radius, diffuse(0, 0, 0)) | {"emitter": emitter}


CONE = {"distribution": "cone", "angle": 25.0, "direction": [2.3, -2.3, -1]}
SPOT = {"distribution": "spot", "exponent": 10.0, "angle": 40.0, "direction": [2.3, -2.3, -1]}

#: name -> (the ball, m of the plate, radius of the lamp, its distribution, parameters of the integrator)
ROWS = {
    "mirror, lamp 0.4": (MIRROR, 0.3, 0.4, {}, {}),
    "mirror, lamp 0.2": (MIRROR, 0.3, 0.2, {}, {}),
    "mirror, lamp 0.1": (MIRROR, 0.3, 0.1, {}, {}),
    "mirror, m = 0.2": (MIRROR, 0.2, 0.2, {}, {}),
    "mirror, m = 0.4": (MIRROR, 0.4, 0.2, {}, {}),
    "mirror, cone": (MIRROR, 0.3, 0.2, CONE, {}),
    "mirror, spot": (MIRROR, 0.3, 0.2, SPOT, {}),
    "mirror, every path": (MIRROR, 0.3, 0.2, {}, {"diffuse_bounces": -1}),
    "glass, lamp 0.4": (GLASS, 0.3, 0.4, {}, {}),
    "glass, lamp 0.2": (GLASS, 0.3, 0.2, {}, {}),
    "glass, cone": (GLASS, 0.3, 0.2, CONE, {}),
    "glass, spot": (GLASS, 0.3, 0.2, SPOT, {}),
    "black enamel, lamp 0.2": (ENAMEL, 0.3, 0.2, {}, {}),
    "silver of 0.005": (silver(0.005), 0.3, 0.2, {}, {}),
    "silver of 0.01": (silver(0.01), 0.3, 0.2, {}, {}),
    "silver of 0.02": (silver(0.02), 0.3, 0.2, {}, {}),
    "silver of 0.05": (silver(0.05), 0.3, 0.2, {}, {}),
    "silver of 0.1": (silver(0.1), 0.3, 0.2, {}, {}),
    "silver of 0.02, every path": (silver(0.02), 0.3, 0.2, {}, {"diffuse_bounces": -1}),
    "glass of 0.01": (frosted(0.01), 0.3, 0.2, {}, {}),
    "glass of 0.05": (frosted(0.05), 0.3, 0.2, {}, {}),
    "glass of 0.1": (frosted(0.1), 0.3, 0.2, {}, {}),
    "glass of 0.05, every path": (frosted(0.05), 0.3, 0.2, {}, {"diffuse_bounces": -1}),
    "enamel of 0.02": (ENAMEL | {"alpha": 0.02}, 0.3, 0.2, {}, {}),
    "Phong, n = 1000": (PHONG | {"exponent": 1e3}, 0.3, 0.2, {}, {}),
    "Phong, n = 100000": (PHONG | {"exponent": 1e5}, 0.3, 0.2, {}, {}),
}


def scene(size, thing, m, radius, distribution):
    """The plate, the ball and the lamp, ``size`` pixels wide and high."""
    film = {"type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgb", "rfilter": {"type": "box"}}
    copper = {"type": "prosim_conductor", "material": "Cu", "alpha": m}
    return mi.load_dict(
        {
            "type": "scene",
            "sensor": camera([0, 3.2, 4.5], [0, 0.3, 0], 32) | {"film": film},
            "plate": floor(copper, 2.5),
            "ball": ball([0.3, 0.7, 0], 0.6, thing),
            "lamp": lamp(radius, distribution),
        }
    )


def render(world, seed, parameters):
    """``(image, seconds)``."""
    integrator = mi.load_dict({"type": "prosim", "adaptive": "none"} | parameters)
    start = time.process_time()
    image = np.array(mi.render(world, integrator=integrator, seed=seed), dtype=np.float64)
    return image, time.process_time() - start


def measured(world, parameters, seeds, reference):
    """``(percentiles, RMSE, seconds of an image, first image)``; another image before warms up."""
    render(world, 99, parameters)
    images, seconds = zip(*(render(world, seed, parameters) for seed in range(seeds)))
    errors = np.stack(images) - reference
    worst = np.percentile(np.abs(errors).max(axis=-1), PERCENTILES)
    return worst, np.sqrt(np.mean(errors**2)), np.median(seconds), images[0]


def picture(path, images):
    """Writes ``images`` side by side."""
    values = np.clip(np.concatenate(images, axis=1), 0, 1)
    shown = np.where(values <= 0.0031308, 12.92 * values, 1.055 * values ** (1 / 2.4) - 0.055)
    Image.fromarray(np.uint8(255 * shown + 0.5)).resize((3 * 192, 192), Image.Resampling.NEAREST).save(path)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--images", type=int, default=6, help="how many of each kind")
    parser.add_argument("--photons", type=int, default=1 << 17)
    parser.add_argument("--only", default="", help="part of a row's name")
    parser.add_argument("--pictures", type=Path, help="folder for without, with and the converged image")
    options = parser.parse_args()
    mi.set_variant(options.variant)
    import mitsuba_prosim  # noqa: F401

    print(f"{'':26}   without: 90, 99, 99.9 %, RMSE, s         with                            with / without")
    for name, (thing, m, radius, distribution, parameters) in ROWS.items():
        if options.only not in name:
            continue
        world = scene(options.size, thing, m, radius, distribution)
        without = {"samples": 5} | parameters
        photons = without | {"caustics": True, "caustic_photons": options.photons}
        converged = photons | {"samples": 16, "caustic_photons": 2 * options.photons}
        reference = np.mean([render(world, 1000 + seed, converged)[0] for seed in range(4)], axis=0)
        a, b = (measured(world, one, options.images, reference) for one in (without, photons))
        columns = "".join(f"{v:8.4f}" for v in (*a[0], *a[1:3], *b[0], *b[1:3]))
        print(f"{name:26}{columns}   " + "".join(f"{v:6.2f}" for v in b[0] / a[0]), flush=True)
        if options.pictures:
            picture(options.pictures / f"{name.replace(' ', '-')}.png", (a[3], b[3], reference))


if __name__ == "__main__":
    main()
