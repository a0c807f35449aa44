"""What a failed test of images leaves behind, so that one can look at it."""

import os
import re
from pathlib import Path

import mitsuba as mi
import numpy as np

FOLDER = Path(__file__).parents[1] / "build" / "failed-images"


def leave(note, **images):
    """Writes images (height, width, channels) as EXR, and a note; the folder, named after the test."""
    test = os.environ.get("PYTEST_CURRENT_TEST", "a test (call)").rpartition(" ")[0]
    folder = FOLDER / re.sub(r"[^\w.-]+", "-", test.rpartition("/")[2]).strip("-")
    folder.mkdir(parents=True, exist_ok=True)
    for name, image in images.items():
        image = np.asarray(image, np.float32)
        image = image[..., :3] if image.shape[2] >= 3 else image[..., :1]
        mi.Bitmap(np.ascontiguousarray(image)).write(str(folder / f"{name}.exr"))
    (folder / "note.txt").write_text(note + "\n", encoding="utf-8")
    return folder
