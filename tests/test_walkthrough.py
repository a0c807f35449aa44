"""Each step of docs/walkthrough.md gives a scene, and its picture is of that scene."""

import sys
import warnings
from pathlib import Path

import mitsuba as mi
import numpy as np
import prosim_scene
import pytest
from prosim_scene import document_of

DOCS = Path(__file__).parents[1] / "docs"
sys.path.append(str(DOCS / "extensions"))
from walkthrough import steps

STEPS = list(steps())


def test_the_steps_lead_to_the_whole_scene():
    assert len(STEPS) == 10
    assert sorted(STEPS[-1][0].splitlines()) == sorted((DOCS / "mug.scn").read_text("utf-8").splitlines())


@pytest.mark.parametrize("number", range(len(STEPS)))
def test_steps_warn_of_what_the_page_says_alone(number):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        document = document_of(STEPS[number][0], f"{number}.scn")
        prosim_scene.load(document, resolution=(8, 6))
    assert [(w.message.code, w.message.line) for w in caught] == [("no-lights", 1)] * (number == 0)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")
@pytest.mark.parametrize("number", range(len(STEPS)))
def test_pictures_are_of_the_steps(variant_rgb, number):
    text, picture = STEPS[number]
    size = (32, 24) if "RESOLUTION" in text else (24, 24)
    scene = prosim_scene.load(document_of(text, f"{number}.scn"), resolution=size, samples=3)
    image = np.clip(np.array(mi.render(mi.load_dict(scene))), 0, 1)[..., :3]
    shown = mi.Bitmap(str(DOCS / picture)).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False)
    blocks = np.array(shown).reshape(size[1], 10, size[0], 10, 3).mean(axis=(1, 3))
    assert np.sqrt(np.mean((image - blocks) ** 2)) < 0.05  # outlines, and grain
