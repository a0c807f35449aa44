"""Tests of a film."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from ..report import Report
from ..statistics import uniform_inputs
from ..subject import Subject


def test_energy(subject: Subject, report: Report) -> None:
    """Samples of the value 1 give pixels of the value 1; a single sample's weight is that of the filter."""
    film = subject.load()
    film.prepare([])
    width, height = film.crop_size()
    n = 64 * width * height if width * height < 2**15 else 16 * width * height
    u = uniform_inputs(n, 2, 1)
    block = film.create_block()
    pos = mi.Point2f(u * np.array([[width], [height]], dtype=np.float32) + np.array(film.crop_offset())[:, None])
    channels = block.channel_count()
    block.put(pos, [mi.Float(1)] * channels)
    film.put_block(block)
    image = np.array(film.develop(), dtype=float)
    report.require(
        "constant samples give a constant image",
        np.abs(image - 1).max(axis=-1).ravel() < 2e-3,
        "they do not",
        share=0.01,
    )
    report.require("pixels are finite", [np.isfinite(image).all()], "they are not")
    film.clear()
    report.require(
        "clear() empties the film", [not np.nan_to_num(np.array(film.develop(raw=True))).any()], "it does not"
    )


TESTS = (test_energy,)
