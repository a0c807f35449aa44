"""Tests of a film."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from ..inputs import uniform
from ..report import Report
from ..subject import Subject


def test_energy(subject: Subject, report: Report) -> None:
    """Samples of the value 1 give pixels of the value 1; clear() removes them."""
    film = subject.load()
    film.prepare([])
    size = np.array(film.crop_size(), dtype=np.float32)[:, None]
    block, n = film.create_block(), int(size.prod()) * (64 if size.prod() < 2**15 else 16)
    pos = mi.Point2f(uniform(n, 2) * size + np.array(film.crop_offset())[:, None])
    block.put(pos, [mi.Float(1)] * block.channel_count())
    film.put_block(block)
    off = np.abs(np.array(film.develop(), dtype=float) - 1).max(axis=-1).ravel()
    report.require("constant samples give a constant image", off < 2e-3, share=0.01)
    film.clear()
    report.require("clear() empties the film", [not np.nan_to_num(np.array(film.develop(raw=True))).any()])


TESTS = (test_energy,)
