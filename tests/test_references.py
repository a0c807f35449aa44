"""The examples look as they did: each beside a reference picture, with a tolerance for rounding alone."""

import mitsuba as mi
import numpy as np
import pytest
import reference_pictures as references
from image_statistics import leave

#: The scenes of a quick run: the thesis's own, and one with glass.
QUICK = ("caustica", "palito")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in QUICK else pytest.mark.slow) for name in references.NAMES]
)
@pytest.mark.filterwarnings("error::prosim_scene.SceneWarning")
def test_example_is_its_reference(variant_rgb, name):
    """And nothing in it is doubtful."""
    if name == "palito" and mi.__version__ == "3.9.0":
        pytest.skip("tangents of meshes, which say how large a pixel is on the stripes, are those of Mitsuba 3.9.1")
    image, reference = references.render(name), references.kept(name)
    assert reference is not None, (
        f"tests/references has no {name}.exr: python tests/reference_pictures.py --keep {name}"
    )
    if not references.same(image, reference):
        pixels, mean, largest = references.changes(image, reference)
        note = f"{pixels:.1%} of the pixels have changed, the mean by {mean:.2%}, one by {largest:.1%}"
        folder = leave(note, image=image, reference=reference, difference=image - reference)
        pytest.fail(
            f"{note}. See {folder}. If that is as it should be: python tests/reference_pictures.py --keep {name}"
        )


def test_tolerance_tells_rounding_from_light(variant_rgb):
    """One per cent more light is seen, in any example; rounding to 16 bits, and every 200th pixel another, are not."""
    for reference in map(references.kept, references.NAMES):
        rng = np.random.default_rng(0)
        assert not references.same(1.01 * reference, reference)
        rounded = reference * (1 + rng.uniform(-1, 1, reference.shape) / 2048)
        other = rng.random(reference.shape[:2]) < 0.005
        rounded[other] *= rng.uniform(0.9, 1.1, (other.sum(), 1))
        assert references.same(rounded, reference)
