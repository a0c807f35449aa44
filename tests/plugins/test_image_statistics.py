"""A failed test of images says why, and leaves the images."""

import image_statistics
import numpy as np
import pytest
from image_statistics import same_expectation
from scenes import read_exr


def noise(mean, seed):
    """Eight noisy images, of which one block is brighter by ``mean``."""
    images = np.random.default_rng(seed).normal(0.5, 0.05, (8, 16, 24, 3))
    images[:, 8:, 16:] += mean
    return images


def test_a_difference_is_named_and_shown(variant_rgb, monkeypatch, tmp_path):
    monkeypatch.setattr(image_statistics, "FOLDER", tmp_path)
    assert same_expectation(noise(0, 1), noise(0, 2)) and not any(tmp_path.iterdir())
    with pytest.raises(AssertionError, match=r"pixels 16\.\.23, 8\.\.15, channel") as raised:
        same_expectation(noise(0, 1), noise(0.05, 2))
    (folder,) = tmp_path.iterdir()
    assert folder.name.startswith("test_image_statistics.py-test_a_difference_is_named_and_shown")
    assert str(folder) in str(raised.value)
    difference = np.array(read_exr(folder / "difference.exr"))
    assert difference[8:, 16:].mean() == pytest.approx(0.05, abs=0.005)
    assert (folder / "image.exr").exists() and (folder / "reference.exr").exists()
    assert "block by block" in (folder / "note.txt").read_text()
