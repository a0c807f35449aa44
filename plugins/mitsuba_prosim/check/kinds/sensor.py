"""Tests of a sensor."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..report import Report
from ..statistics import rows, uniform_inputs
from ..subject import Subject

#: Number of rays.
INPUTS = 2**12


def rays(sensor: Any, film: np.ndarray, differential: bool = False) -> tuple[Any, Any]:
    """Rays through places of the film, and their weights."""
    u, sample = uniform_inputs(INPUTS, 3, 1), sensor.sample_ray_differential if differential else sensor.sample_ray
    return sample(mi.Float(0.0), mi.Float(u[0]), mi.Point2f(film.astype(np.float32)), mi.Point2f(u[1:]))


def where(film: np.ndarray) -> Any:
    """The place on the film of ray i."""
    return lambda i: f"film ({film[0, i]:.3f}, {film[1, i]:.3f})"


def test_rays(subject: Subject, report: Report) -> None:
    """Rays are unit vectors with finite weights; differentials do not change them; crops are parts of the whole."""
    sensor, film = subject.load(), uniform_inputs(INPUTS, 2, 2)
    ray, weight = rays(sensor, film)
    d, weight = rows(ray.d, INPUTS), rows(weight, INPUTS)
    place = where(film)
    report.require("weights are finite, not negative", np.isfinite(weight) & (weight >= 0), "they are not", place)
    report.require("directions are unit vectors", np.abs(np.linalg.norm(d, axis=0) - 1) < 1e-3, where=place)
    ray, other = rays(sensor, film, differential=True)
    report.equal("sample_ray_differential() = sample_ray()", rows(ray.d, INPUTS), d, place, tolerance=1e-3)
    report.equal("sample_ray_differential() = sample_ray()", rows(other, INPUTS), weight, place)
    whole, part = (
        subject_with_film(subject, **crop)
        for crop in ({}, {"crop_offset_x": 20, "crop_offset_y": 12, "crop_width": 40, "crop_height": 24})
    )
    if whole is None or part is None:
        return
    inside = np.array([[20], [12]]) / [[80], [60]] + film * np.array([[40], [24]]) / [[80], [60]]
    here, there = rays(part, film)[0], rays(whole, inside)[0]
    report.equal(
        "a crop is a part of the whole", rows(here.d, INPUTS), rows(there.d, INPUTS), place, tolerance=2e-3, floor=1e-3
    )
    report.equal(
        "a crop is a part of the whole", rows(here.o, INPUTS), rows(there.o, INPUTS), place, tolerance=2e-3, floor=1e-3
    )


def subject_with_film(subject: Subject, **crop: int) -> Any:
    """The sensor with a film of 80 x 60 pixels; None if it has no such film."""
    film = mi.load_dict({"type": "hdrfilm", "width": 80, "height": 60, "rfilter": {"type": "box"}, **crop})
    children = [k for k in subject.props if k.startswith("film") or "film" in str(subject.props[k])[:40].lower()]
    try:
        return subject.load(**dict.fromkeys(children), film=film)
    except (RuntimeError, TypeError):
        return None


def test_projection(subject: Subject, report: Report) -> None:
    """sample_direction() projects a point of a ray to the place of the film from which the ray comes."""
    sensor, film = subject.load(), 0.02 + 0.96 * uniform_inputs(INPUTS, 2, 3)
    ray, _ = rays(sensor, film)
    it = dr.zeros(mi.Interaction3f, INPUTS)
    it.p = ray(mi.Float(3.0))
    ds, weight = sensor.sample_direction(it, mi.Point2f(0.5, 0.5))
    size = np.array(sensor.film().crop_size(), dtype=float)[:, None]
    found = (rows(weight, INPUTS) > 0).any(axis=0)
    report.require("points of rays are seen", found, "sample_direction() returns 0", where(film), share=0.02)
    report.equal(
        "sample_direction() inverts sample_ray()",
        rows(ds.uv, INPUTS) / size,
        film,
        where(film),
        on=found,
        tolerance=5e-3,
        share=0.02,
    )


TESTS = test_rays, test_projection
