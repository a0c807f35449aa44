"""Tests of a shape."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from ..inputs import directions, interaction, rows, uniform
from ..report import Report
from ..statistics import welch
from ..subject import Subject

#: Number of inputs without statistics, and of lines that measure the area.
INPUTS, LINES = 2**13, 2**18


def scene_of(subject: Subject) -> tuple[Any, Any, np.ndarray, float]:
    """The shape in a scene of its own, the centre and the length of the diagonal of its box."""
    scene = mi.load_dict({"type": "scene", "shape": subject.load()})
    box = scene.bbox()
    size = float(np.linalg.norm(np.array(box.extents(), dtype=float)))
    return scene, scene.shapes()[0], np.array(box.center(), dtype=float), size


def test_positions(subject: Subject, report: Report) -> None:
    """Sampled positions lie on the shape, have its normal, and the density of pdf_position()."""
    scene, shape, _, size = scene_of(subject)
    ps = shape.sample_position(0.0, mi.Point2f(uniform(INPUTS, 2, 1)))
    report.equal("pdf of a position = pdf_position()", ps.pdf, shape.pdf_position(ps))
    report.equal("pdf of a position = 1 / surface_area()", rows(ps.pdf) * rows(shape.surface_area()), 1.0)
    si = scene.ray_intersect(mi.Ray3f(ps.p + ps.n * (1e-3 * size), -ps.n))
    met = np.abs(rows(si.t, INPUTS)[0] - 1e-3 * size) < 2e-4 * size
    report.require("rays along the normal meet sampled positions", met, share=0.02)
    cos = np.abs((rows(si.n, INPUTS) * rows(ps.n, INPUTS)).sum(axis=0))
    report.require("sampled normals are those that rays meet", cos > 0.999, on=met, share=0.02)
    report.unit("normals", si.n, on=met)
    report.unit("shading normals", si.sh_frame.n, on=met)
    low, high = (np.array(v, dtype=float)[:, None] for v in (scene.bbox().min, scene.bbox().max))
    p = rows(ps.p, INPUTS)
    report.require("bbox() holds all positions", (p >= low - 1e-4 * size) & (p <= high + 1e-4 * size))


def test_area(subject: Subject, report: Report) -> None:
    """Random lines meet the shape as often as surface_area() says."""
    scene, shape, centre, size = scene_of(subject)
    radius = 0.51 * size
    offset = mi.warp.square_to_uniform_disk_concentric(mi.Point2f(uniform(LINES, 2, 3)))
    d = mi.warp.square_to_uniform_sphere(mi.Point2f(uniform(LINES, 2, 4)))
    ray = mi.Ray3f(mi.Point3f(centre) + mi.Frame3f(d).to_world(mi.Vector3f(offset.x, offset.y, -2) * radius), d)
    hits, alive = np.zeros(LINES), np.ones(LINES, dtype=bool)
    for _ in range(16):
        si = scene.ray_intersect(ray)
        alive = alive & rows(si.is_valid(), LINES)[0].astype(bool)
        hits += alive
        ray = si.spawn_ray(d)
    expected = rows(shape.surface_area())[0, 0] / (2 * np.pi * radius**2)
    report.add("random lines find surface_area()", **welch(hits, np.full(LINES, expected)))


def test_directions(subject: Subject, report: Report) -> None:
    """sample_direction() has the density of pdf_direction()."""
    _, shape, centre, size = scene_of(subject)
    p = mi.Point3f((centre[:, None] + directions(INPUTS, 6) * size).astype(np.float32))
    it = interaction(mi.Interaction3f, INPUTS, p=p)
    ds = shape.sample_direction(it, mi.Point2f(uniform(INPUTS, 2, 7)))
    on = np.isfinite(rows(ds.pdf, INPUTS)[0])
    report.equal("pdf of a direction = pdf_direction()", ds.pdf, shape.pdf_direction(it, ds), on=on)


TESTS = test_positions, test_area, test_directions
