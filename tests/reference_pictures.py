"""The reference pictures of the examples: ``python tests/reference_pictures.py [--keep] [NAME...]``.

Renders the scenes of ``examples`` at a tenth of their width and height, says how far each is from its reference in
``tests/references`` (half floats, linear), and puts both and their difference side by side into ``build/references``.
With ``--keep`` what was rendered becomes the reference.
"""

import argparse
import tempfile
from pathlib import Path

import mitsuba as mi
import mitsuba_prosim  # noqa: F401  (registers the plugins)
import numpy as np
import prosim_scene

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
FOLDER = ROOT / "tests" / "references"
SHOWN = ROOT / "build" / "references"
NAMES = sorted(path.stem for path in EXAMPLES.glob("*.scn"))

#: A pixel has changed if it differs by more than this share of the sum of its value and the image's mean.
TOLERANCE = 0.004
#: So many pixels may have changed, and so much the mean.
PIXELS, MEAN = 0.02, 0.001


def render(name):
    """The picture of an example, translated to XML, with the scene's own settings: (height, width, 3), linear."""
    path = EXAMPLES / f"{name}.scn"
    width, height = prosim_scene.parse(prosim_scene.read(path), path).view.resolution
    with tempfile.TemporaryDirectory() as folder:
        xml = prosim_scene.translate(path, folder, resolution=(width // 10, height // 10))
        return np.array(mi.render(mi.load_file(str(xml), parallel=False), seed=0))


def kept(name):
    """The reference, or None."""
    path = FOLDER / f"{name}.exr"
    return np.array(mi.Bitmap(str(path)).convert(component_format=mi.Struct.Type.Float32)) if path.exists() else None


def keep(name, image):
    """Makes an image the reference."""
    FOLDER.mkdir(exist_ok=True)
    bitmap = mi.Bitmap(np.ascontiguousarray(image, np.float32))
    bitmap.convert(component_format=mi.Struct.Type.Float16).write(str(FOLDER / f"{name}.exr"))


def changes(image, reference):
    """``(share of the pixels that have changed, relative change of the mean, largest change)``.

    Other roundings (another processor, another width of its vectors) change a pixel by some 1e-6 of its value, half
    floats by 5e-4. Only a sample that meets an edge, or a pixel whose noise is just the threshold, can change by more:
    between AVX-512 and AVX2 that was one pixel of all the examples. A light that is one per cent brighter changes the
    mean by as much, and a fiftieth of the pixels at least.
    """
    relative = (np.abs(image - reference) / (np.abs(reference) + reference.mean())).max(axis=2)
    return np.mean(relative > TOLERANCE), image.mean() / reference.mean() - 1, relative.max()


def same(image, reference):
    """Whether an image is the reference, but for rounding."""
    pixels, mean, _ = changes(image, reference)
    return pixels <= PIXELS and abs(mean) <= MEAN


def main():
    parser = argparse.ArgumentParser(description="Renders the examples, and says what has changed.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"{', '.join(NAMES)} (default: all)")
    parser.add_argument("--keep", action="store_true", help="make what is rendered the references")
    parser.add_argument("--variant", default="llvm_ad_rgb", help="of Mitsuba (default: %(default)s)")
    options = parser.parse_args()
    if unknown := set(options.names) - set(NAMES):
        parser.error(f"there is no {' or '.join(sorted(unknown))}; there are {', '.join(NAMES)}")
    mi.set_variant(options.variant)
    SHOWN.mkdir(parents=True, exist_ok=True)
    print(f"{'':20}{'pixels':>9}{'mean':>10}{'largest':>10}   changed")
    for name in options.names or NAMES:
        image, reference = render(name), kept(name)
        if reference is None:
            print(f"{name:20} is new")
        elif reference.shape != image.shape:
            print(f"{name:20} has another size: {reference.shape[:2]}, now {image.shape[:2]}")
        else:
            pixels, mean, largest = changes(image, reference)
            print(f"{name:20}{pixels:9.1%}{mean:10.2%}{largest:10.1%}   {'' if same(image, reference) else 'yes'}")
            sheet = (
                np.concatenate([reference, image, 0.2 + 4 * np.abs(image - reference)], axis=1)
                .repeat(6, 0)
                .repeat(6, 1)
            )
            mi.util.write_bitmap(str(SHOWN / f"{name}.png"), sheet.astype(np.float32))
        if options.keep:
            keep(name, image)
    print(f"Side by side in {SHOWN}: the reference, the picture, and four times the difference")


if __name__ == "__main__":
    main()
