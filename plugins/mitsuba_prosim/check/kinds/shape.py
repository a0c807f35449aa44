"""Tests of a shape."""

from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from ...compat import GROUP, INSTANCE
from ..inputs import directions, interaction, octant, rows, uniform
from ..tests import Tests

#: Number of inputs without statistics, and of lines that measure the area.
INPUTS, LINES = 2**13, 2**16


class Placed(NamedTuple):
    """A shape in a scene of its own, the centre and the length of the diagonal of its box."""

    scene: Any
    shape: Any
    centre: np.ndarray
    size: float


class Shape(Tests):
    """Tests of a shape."""

    def prepared(self, loaded: Any) -> Placed:
        """The shape in a scene of its own. Raises NotImplementedError for a group, and for an instance of one."""
        if loaded.class_name() in (GROUP, INSTANCE):
            raise NotImplementedError("the shapes of a group are tested alone")
        scene = mi.load_dict({"type": "scene", "shape": loaded})
        low, high = (np.array(v, dtype=float) for v in (scene.bbox().min, scene.bbox().max))
        return Placed(scene, scene.shapes()[0], (low + high) / 2, float(np.linalg.norm(high - low)))

    def test_positions(self, placed: Placed) -> None:
        """Sampled positions lie on the shape, have its normal, and the density of pdf_position()."""
        scene, shape, _, size = placed
        equal, require = self.report.equal, self.report.require
        ps = shape.sample_position(0.0, mi.Point2f(uniform(INPUTS, 2, 1)))
        dr.eval(ps)
        equal("pdf of a position = pdf_position()", ps.pdf, shape.pdf_position(ps))
        equal("pdf of a position = 1 / surface_area()", rows(ps.pdf) * rows(shape.surface_area()), 1.0)
        si = scene.ray_intersect(mi.Ray3f(ps.p + ps.n * (1e-3 * size), -ps.n))
        dr.eval(si)
        met = np.abs(rows(si.t, INPUTS)[0] - 1e-3 * size) < 2e-4 * size
        require("rays along the normal meet sampled positions", met, share=0.02)
        cos = np.abs((rows(si.n, INPUTS) * rows(ps.n, INPUTS)).sum(axis=0))
        require("sampled normals are those that rays meet", cos > 0.999, on=met, share=0.02)
        self.report.unit("normals", si.n, on=met)
        self.report.unit("shading normals", si.sh_frame.n, on=met)
        low, high = (rows(v) for v in (scene.bbox().min, scene.bbox().max))
        p = rows(ps.p, INPUTS)
        require("bbox() holds all positions", (p >= low - 1e-4 * size) & (p <= high + 1e-4 * size))

    def test_area(self, placed: Placed) -> None:
        """Random lines meet the shape as often as surface_area() says, and at places that are distributed as those of
        sample_position().
        """
        scene, shape, centre, size = placed
        radius, middle = 0.51 * size, centre[:, None] + 1e-3 * size * np.array([[1], [2], [3]])
        offset = mi.warp.square_to_uniform_disk_concentric(mi.Point2f(uniform(LINES, 2, 3)))
        d = mi.warp.square_to_uniform_sphere(mi.Point2f(uniform(LINES, 2, 4)))
        ray = mi.Ray3f(mi.Point3f(centre) + mi.Frame3f(d).to_world(mi.Vector3f(offset.x, offset.y, -2) * radius), d)
        hits, alive = np.zeros((8, LINES)), np.ones(LINES, dtype=bool)
        for _ in range(16):
            si = scene.ray_intersect(ray)
            dr.eval(si)
            alive = alive & rows(si.is_valid(), LINES)[0].astype(bool)
            hits[octant(rows(si.p) - middle), np.arange(LINES)] += alive
            ray = si.spawn_ray(d)
        expected = float(rows(shape.surface_area())[0, 0]) / (2 * np.pi * radius**2)
        sampled = octant(rows(shape.sample_position(0.0, mi.Point2f(uniform(LINES, 2, 5))).p) - middle)
        for side in range(8):
            test, found = "random lines find the area of sampled positions", expected * (sampled == side)
            self.report.same_mean(test, hits[side], found, f"octant {side}")

    def test_directions(self, placed: Placed) -> None:
        """sample_direction() has the density of pdf_direction()."""
        p = placed.centre[:, None] + directions(INPUTS, 6) * placed.size
        it = interaction(mi.Interaction3f, INPUTS, p=mi.Point3f(p.astype(np.float32)))
        ds = placed.shape.sample_direction(it, mi.Point2f(uniform(INPUTS, 2, 7)))
        dr.eval(ds)
        on = np.isfinite(rows(ds.pdf, INPUTS)[0])
        self.report.equal("pdf of a direction = pdf_direction()", ds.pdf, placed.shape.pdf_direction(it, ds), on=on)
