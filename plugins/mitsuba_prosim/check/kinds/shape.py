"""Tests of a shape."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..report import NOTE, Report
from ..statistics import add_welch, directions, rows, uniform_inputs
from ..subject import Subject

#: Number of inputs without statistics, and of lines that measure the area.
INPUTS, LINES = 2**13, 2**18


def scene_of(subject: Subject) -> tuple[Any, Any]:
    """The shape in a scene of its own."""
    scene = mi.load_dict({"type": "scene", "shape": subject.load()})
    return scene, scene.shapes()[0]


def test_positions(subject: Subject, report: Report) -> None:
    """Sampled positions lie on the shape, have its normal, and the density of pdf_position()."""
    scene, shape = scene_of(subject)
    ps = shape.sample_position(0.0, mi.Point2f(uniform_inputs(INPUTS, 2, 1)))
    pdf, stated, area = rows(ps.pdf, INPUTS), rows(shape.pdf_position(ps), INPUTS), rows(shape.surface_area(), INPUTS)
    report.equal("pdf of a position = pdf_position()", pdf, stated)
    report.equal("pdf of a position = 1 / surface_area()", pdf * area, 1.0)
    size = float(np.linalg.norm(np.array(scene.bbox().extents(), dtype=float)))
    si = scene.ray_intersect(mi.Ray3f(ps.p + ps.n * (1e-3 * size), -ps.n))
    met = np.isfinite(rows(si.t, INPUTS)[0]) & (np.abs(rows(si.t, INPUTS)[0] - 1e-3 * size) < 2e-4 * size)
    report.require("rays along the normal meet sampled positions", met, "they do not", share=0.02)
    cos = np.abs((rows(si.n, INPUTS) * rows(ps.n, INPUTS)).sum(axis=0))
    report.require("sampled normals are those that rays meet", cos > 0.999, "they differ", on=met, share=0.02)
    low, high = (np.array(v, dtype=float)[:, None] for v in (scene.bbox().min, scene.bbox().max))
    p = rows(ps.p, INPUTS)
    report.require("bbox() holds all positions", (p >= low - 1e-4 * size) & (p <= high + 1e-4 * size), "it does not")


def test_area(subject: Subject, report: Report) -> None:
    """Random lines meet the shape as often as surface_area() says, everywhere as often as positions are sampled."""
    scene, shape = scene_of(subject)
    centre = np.array(scene.bbox().center(), dtype=float)
    radius = 0.51 * float(np.linalg.norm(np.array(scene.bbox().extents(), dtype=float)))
    offset = mi.warp.square_to_uniform_disk_concentric(mi.Point2f(uniform_inputs(LINES, 2, 3)))
    d = mi.warp.square_to_uniform_sphere(mi.Point2f(uniform_inputs(LINES, 2, 4)))
    ray = mi.Ray3f(mi.Point3f(centre) + mi.Frame3f(d).to_world(mi.Vector3f(offset.x, offset.y, -2) * radius), d)
    hits, alive = np.zeros(LINES), np.ones(LINES, dtype=bool)
    for _ in range(16):
        si = scene.ray_intersect(ray)
        alive = alive & rows(si.is_valid(), LINES)[0].astype(bool)
        hits += alive
        ray = si.spawn_ray(d)
        if not alive.any():
            break
    expected = float(np.array(shape.surface_area()).ravel()[0]) / (2 * np.pi * radius**2)
    add_welch(report, "random lines find surface_area()", hits, np.full(LINES, expected), "")


def test_parameterisation(subject: Subject, report: Report) -> None:
    """eval_parameterization() of uv is the point that has this uv; normals are unit vectors."""
    scene, shape = scene_of(subject)
    ps = shape.sample_position(0.0, mi.Point2f(uniform_inputs(INPUTS, 2, 5)))
    si = scene.ray_intersect(mi.Ray3f(ps.p + 0.01 * ps.n, -ps.n))
    found = rows(si.is_valid(), INPUTS)[0].astype(bool)
    for name, normal in (("n", si.n), ("sh_frame.n", si.sh_frame.n)):
        length = np.linalg.norm(rows(normal, INPUTS), axis=0)
        report.require(f"{name} is a unit vector", np.abs(length - 1) < 1e-3, on=found)
    again = shape.eval_parameterization(si.uv)
    off = np.linalg.norm(rows(again.p, INPUTS) - rows(si.p, INPUTS), axis=0)
    size = float(np.linalg.norm(np.array(scene.bbox().extents(), dtype=float)))
    report.require("eval_parameterization() inverts uv", off < 1e-3 * size, on=found, share=0.02, worst=NOTE)


def test_directions(subject: Subject, report: Report) -> None:
    """sample_direction() has the density of pdf_direction()."""
    scene, shape = scene_of(subject)
    centre, size = np.array(scene.bbox().center(), dtype=float), np.array(scene.bbox().extents(), dtype=float)
    it = dr.zeros(mi.Interaction3f, INPUTS)
    it.p = mi.Point3f((centre[:, None] + directions(INPUTS, 6) * np.linalg.norm(size)).astype(np.float32))
    ds = shape.sample_direction(it, mi.Point2f(uniform_inputs(INPUTS, 2, 7)))
    pdf, stated = rows(ds.pdf, INPUTS), rows(shape.pdf_direction(it, ds), INPUTS)
    report.equal("pdf of a direction = pdf_direction()", pdf, stated, on=np.isfinite(pdf[0]))


TESTS = test_positions, test_area, test_parameterisation, test_directions
