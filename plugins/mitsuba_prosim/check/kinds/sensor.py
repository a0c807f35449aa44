"""Tests of a sensor."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from ..inputs import interaction, place, rows, uniform
from ..report import Report
from ..subject import Subject

#: Number of rays.
INPUTS = 2**12

#: A film of 80 x 60 pixels, and a crop of it.
FILM = {"type": "hdrfilm", "width": 80, "height": 60, "rfilter": {"type": "box"}}
CROP = {"crop_offset_x": 20, "crop_offset_y": 12, "crop_width": 40, "crop_height": 24}


def rays(sample: Any, film: np.ndarray) -> tuple[Any, Any]:
    """Rays through places of the film, and their weights."""
    u = uniform(INPUTS, 3, 1)
    return sample(mi.Float(0.0), mi.Float(u[0]), mi.Point2f(film.astype(np.float32)), mi.Point2f(u[1:]))


def test_rays(subject: Subject, report: Report) -> None:
    """Rays are unit vectors with finite weights; differentials do not change them."""
    sensor, film = subject.load(), uniform(INPUTS, 2, 2)
    (ray, weight), (other, same) = (rays(f, film) for f in (sensor.sample_ray, sensor.sample_ray_differential))
    report.finite("weight", weight, place("film", film))
    report.unit("directions", ray.d, place("film", film))
    report.equal("sample_ray_differential() = sample_ray()", other.d, ray.d, place("film", film), tolerance=1e-3)
    report.equal("sample_ray_differential() = sample_ray()", same, weight, place("film", film))


def test_crop(subject: Subject, report: Report) -> None:
    """A crop is a part of the whole."""
    films = [k for k in subject.props if k.startswith("film") or "film" in str(subject.props[k])[:40].lower()]
    try:
        whole, part = (subject.load(**dict.fromkeys(films), film=mi.load_dict({**FILM, **crop})) for crop in ({}, CROP))
    except (RuntimeError, TypeError):
        return  # it has no such film
    film = uniform(INPUTS, 2, 2)
    here, there = rays(part.sample_ray, film)[0], rays(whole.sample_ray, [[0.25], [0.2]] + film * [[0.5], [0.4]])[0]
    for a, b in ((here.d, there.d), (here.o, there.o)):
        report.equal("a crop is a part of the whole", a, b, place("film", film), tolerance=2e-3, floor=1e-3)


def test_projection(subject: Subject, report: Report) -> None:
    """sample_direction() projects a point of a ray to the place of the film from which the ray comes."""
    sensor, film = subject.load(), 0.02 + 0.96 * uniform(INPUTS, 2, 3)
    it = interaction(mi.Interaction3f, INPUTS, p=rays(sensor.sample_ray, film)[0](mi.Float(3.0)))
    ds, weight = sensor.sample_direction(it, mi.Point2f(0.5, 0.5))
    found = (rows(weight, INPUTS) > 0).any(axis=0)
    report.require("points of rays are seen", found, place("film", film), share=0.02)
    uv = rows(ds.uv, INPUTS) / np.array(sensor.film().crop_size(), dtype=float)[:, None]
    test = "sample_direction() inverts sample_ray()"
    report.equal(test, uv, film, place("film", film), on=found, tolerance=5e-3, share=0.02)


TESTS = test_rays, test_crop, test_projection
