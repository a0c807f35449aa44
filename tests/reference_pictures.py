"""The reference pictures of the examples: ``python tests/reference_pictures.py [--keep] [NAME...]``.

Renders the scenes of ``examples`` at a tenth of their width and height, and says how far each is from its reference in
``tests/references`` (half floats, linear). With ``--keep`` what was rendered becomes the reference.
"""

import sys
import tempfile
from pathlib import Path

import mitsuba as mi
import mitsuba_prosim  # noqa: F401  (registers the plugins)
import numpy as np
import OpenEXR
import prosim_scene

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
FOLDER = ROOT / "tests" / "references"
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
    return OpenEXR.File(str(path)).channels()["RGB"].pixels.astype(np.float32) if path.exists() else None


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
    mi.set_variant("llvm_ad_rgb")
    for name in [word for word in sys.argv[1:] if word != "--keep"] or NAMES:
        image, reference = render(name), kept(name)
        if reference is not None and reference.shape == image.shape:
            pixels, mean, largest = changes(image, reference)
            print(f"{name}: {pixels:.1%} of the pixels have changed, the mean by {mean:.2%}, one by {largest:.1%}")
        if "--keep" in sys.argv:
            keep(name, image)


if __name__ == "__main__":
    main()
