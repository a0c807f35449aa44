"""Draws docs/pictures/denoising.jpg: what is hard for a denoiser, raw, denoised, mixed, converged, and the errors.

``python docs/denoising.py [--cache FOLDER]``; needs mitsuba-oidn, and some minutes for the converged images.
"""

import argparse
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS.parent / "benchmarks"))
from suite import Subject, begin

begin("llvm_ad_rgb", 0)
from denoise import Hard
from mitsuba_prosim.denoising import halves
from mitsuba_prosim.denoising.pyramid import average

SIZE = 128
ROWS = [Hard("texture", SIZE), Hard("lines", SIZE), Subject("caustica", SIZE), Hard("highlights", SIZE)]


def row(subject, reference):
    """Raw, denoised, final and converged; the error of the final image, as said and as it is. Shape (height, width)."""
    integrator = subject.integrator(adaptive="none", samples=3)
    found = halves.halves(subject.scene, subject.scene.sensors()[0], integrator).denoised()
    truth = reference.image
    white = np.percentile(truth, 99)
    shown = [np.clip(image / white, 0, 1) for image in (found.raw, found.denoised, found.final, truth)]
    true = np.sqrt(average(np.mean((found.final - truth) ** 2, axis=2), 8))
    errors = [np.clip(4 * error / white, 0, 1) for error in (found.final_error, true)]
    return np.concatenate([*shown, *(np.repeat(error[..., None], 3, axis=2) for error in errors)], axis=1)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, default=Path("~/.cache/prosim-benchmarks").expanduser())
    cache = parser.parse_args().cache
    picture = np.concatenate([row(subject, subject.reference(cache, 60.0)) for subject in ROWS])
    bitmap = mi.Bitmap(picture.astype(np.float32)).convert(component_format=mi.Struct.Type.UInt8, srgb_gamma=True)
    bitmap.write(str(DOCS / "pictures" / "denoising.jpg"), quality=88)


if __name__ == "__main__":
    main()
