"""Light through glass and by mirrors against Mitsuba's ``path``, region by region.

    python benchmarks/agreement.py [--images 8] [--spp 512] [--only "cylinder, cone"]

A thing on a floor, under a lamp that ``path`` can find; ours follows every path, with photons. Images of 48 x 48 pixels
are compared in 36 blocks. Ours are rendered with pixels an eighth as wide, as photons are blurred by a pixel. Printed
for each thing and lamp: the largest |z| of the blocks (Welch's t, with some ten degrees of freedom), how likely one as
large is among so many by chance, and by how much the whole differs, with its standard error. Blocks darker than a
hundredth of the mean are left out: beyond the edge of a beam ``path`` finds a way to the lamp a few times in a million,
and its mean is nothing like normally distributed. Of what absorbs, ``volpath`` is asked.
"""

import argparse

import mitsuba as mi
import numpy as np
import prosim_scene
from prosim_scene import document_of
from scenes import ball, camera, floor, rgb
from scipy import stats

PIXELS, FINER, BLOCK = 48, 8, 8
GLASS = {"type": "dielectric"}
COPPER = {"type": "prosim_conductor", "material": "Cu"}
GREEN = {"type": "homogeneous", "albedo": 0.0, "sigma_t": rgb(1.0, 0.3, 0.75)}


def place():
    return mi.ScalarTransform4f()


def cylinder(radius, height, bsdf, lids=False):
    """Standing on the floor, with its normals outward; open if it has no lids."""
    faces = {"side": {"type": "cylinder", "p0": [0, 0.02, 0], "p1": [0, height, 0], "radius": radius, "bsdf": bsdf}}
    for name, y, turn in (("lower", 0.02, 90), ("upper", height, -90)) if lids else ():
        put = place().translate([0, y, 0]).rotate([1, 0, 0], turn).scale(radius)
        faces[name] = {"type": "disk", "to_world": put, "bsdf": bsdf}
    return faces


def ring():
    """Of copper, the inner side of a cylinder: it gathers light in the shape of a kidney."""
    faces = cylinder(0.9, 0.7, COPPER)
    return {"ring": faces["side"] | {"flip_normals": True}}


#: Two balls' common part, on the way from the lamp to the floor.
LENS = """
VIEW  LIGHTS POINT position 0 0 9  CSG-TREE * SPHERE 0 SPHERE 1
SURFACE 0 material dieletrico n-refr = 1.5  SURFACE 1 material dieletrico n-refr = 1.5
TRANSFORM 0 SCALE (1.3 1.3 1.3) TRANSLATE (0 -1 0) ROTATE-Z (30) TRANSLATE (-.2 1.3 .1)
TRANSFORM 1 SCALE (1.3 1.3 1.3) TRANSLATE (0 1 0) ROTATE-Z (30) TRANSLATE (-.2 1.3 .1)
END
"""


def lens():
    return {"lens": prosim_scene.load(document_of(LENS, "lens.scn"))["surface_0"]}


def mirrored():
    """A ball of glass, and behind it a mirror that shows the floor again."""
    put = place().translate([0, 1.5, -1.6]).scale([3, 1.5, 1])
    return {"ball": one(GLASS), "mirror": {"type": "rectangle", "to_world": put, "bsdf": {"type": "conductor"}}}


def through():
    """A ball of glass behind a pane of it."""
    put = place().look_at(origin=[0, 2.8, 4.2], target=[0, 0, 0], up=[0, 1, 0]).scale([1.2, 1.2, 0.05])
    return {"ball": one(GLASS), "pane": {"type": "cube", "to_world": put, "bsdf": GLASS}}


def one(bsdf, **more):
    return ball([0, 1, 0], 0.7, bsdf) | more


THINGS = {
    "ball": lambda: {"ball": one(GLASS)},
    "lens": lens,
    "cylinder": lambda: cylinder(0.5, 1.2, GLASS, lids=True),
    "rough glass": lambda: {"ball": one({"type": "prosim_dielectric", "int_ior": 1.5, "alpha": 0.15})},
    "copper ring": ring,
    "rough copper": lambda: {"ball": one(COPPER | {"alpha": 0.15})},
    "seen in a mirror": mirrored,
    "through a second glass": through,
    "coloured ball": lambda: {"ball": one(GLASS, interior=GREEN)},
}

AIMED = {"direction": [2.6, -3.4, -0.8]}

#: Distribution of the lamp, a sphere.
LAMPS = {
    "sphere": {},
    "cone": {"distribution": "cone", "angle": 35.0} | AIMED,
    "spot": {"distribution": "spot", "exponent": 8.0, "angle": 50.0} | AIMED,
}


def scene(thing, distribution, pixels):
    film = {"type": "hdrfilm", "width": pixels, "height": pixels, "pixel_format": "rgb", "rfilter": {"type": "box"}}
    black = {"type": "diffuse", "reflectance": 0.0}
    lamp = ball([-2.6, 4.4, 0.8], 0.8, black) | {"emitter": {"type": "prosim_area", "radiance": 20.0} | distribution}
    return mi.load_dict(
        {
            "type": "scene",
            "sensor": camera([0, 4, 6], [0, 0.3, 0], 36) | {"film": film},
            "floor": floor({"type": "diffuse", "reflectance": rgb(0.5, 0.5, 0.5)}),
            "lamp": lamp,
        }
        | THINGS[thing]()
    )


def blocks(image):
    """The means of the blocks, in green, shape (36,), and last that of the whole."""
    finer = image[..., 1].reshape(PIXELS // BLOCK, image.shape[0] * BLOCK // PIXELS, PIXELS // BLOCK, -1)
    means = finer.mean(axis=(1, 3)).ravel()
    return np.append(means, means.mean())


def compared(thing, distribution, images, spp):
    """``(largest |z|, p, by how much the whole differs, error of that)``."""
    ours, theirs = (scene(thing, distribution, pixels) for pixels in (PIXELS * FINER, PIXELS))
    photons = {"caustics": True, "caustic_photons": 1 << 19}
    every = {"diffuse_bounces": -1, "max_level": -1, "rr_depth": 200}
    shared = mi.load_dict({"type": "prosim", "samples": 3, "adaptive": "none"} | every | photons)
    kind = "volpath" if "coloured" in thing else "path"
    path = mi.load_dict({"type": kind, "max_depth": 200, "rr_depth": 200})
    x = np.stack([blocks(np.array(mi.render(ours, integrator=shared, seed=i))) for i in range(images)])
    y = np.stack([blocks(np.array(mi.render(theirs, integrator=path, seed=99 + i, spp=spp))) for i in range(images)])
    lit = y.mean(axis=0)[:-1] > 0.01 * y[:, -1].mean()
    test = stats.ttest_ind(x[:, :-1][:, lit], y[:, :-1][:, lit], equal_var=False)
    whole = [a[:, -1].mean() for a in (x, y)]
    error = np.sqrt(sum(a[:, -1].var(ddof=1) / images for a in (x, y))) / whole[1]
    return np.abs(test.statistic).max(), 1 - (1 - test.pvalue.min()) ** lit.sum(), whole[0] / whole[1] - 1, error


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--images", type=int, default=8, help="how many of each kind")
    parser.add_argument("--spp", type=int, default=512, help="samples of a pixel by path, for an image")
    parser.add_argument("--only", default="", help="part of a row's name")
    options = parser.parse_args()
    mi.set_variant(options.variant)
    import mitsuba_prosim  # noqa: F401

    print("| | largest \\|z\\| | p | the whole, % |\n|---|---:|---:|---:|")
    for thing in THINGS:
        for lamp, distribution in LAMPS.items():
            if options.only in (name := f"{thing}, {lamp}"):
                z, p, ratio, error = compared(thing, distribution, options.images, options.spp)
                print(f"| {name} | {z:.1f} | {p:.2f} | {100 * ratio:+.2f} ± {100 * error:.2f} |", flush=True)


if __name__ == "__main__":
    main()
