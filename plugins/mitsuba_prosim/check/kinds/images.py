"""Tests of what makes images: sensors, films, filters, samplers and integrators."""

from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..inputs import interaction, rows, slopes, uniform
from ..report import FAILS, NOTE, OK, SKIPPED, normal_p
from ..tests import Tests, motion

#: Number of rays, and of pixels of a sampler with one sample each.
INPUTS, PIXELS = 2**12, 2**16

#: A film of 80 x 60 pixels, and a crop of it.
FILM = {"type": "hdrfilm", "width": 80, "height": 60, "rfilter": {"type": "box"}}
CROP = {"crop_offset_x": 20, "crop_offset_y": 12, "crop_width": 40, "crop_height": 24}


def rays(sample: Any, film: Any) -> tuple[Any, Any]:
    """Rays through places of the film, and their weights."""
    u = uniform(INPUTS, 3, 1)
    return sample(mi.Float(0.0), mi.Float(u[0]), mi.Point2f(film), mi.Point2f(u[1:]))


class Sensor(Tests):
    """Tests of a sensor."""

    def test_rays(self, sensor: Any) -> None:
        """Rays are unit vectors with finite weights; differentials do not change them."""
        film = uniform(INPUTS, 2, 2)
        where = {"film": film}
        (ray, weight), (other, same) = (rays(f, film) for f in (sensor.sample_ray, sensor.sample_ray_differential))
        self.report.finite("weight", weight, where)
        self.report.unit("directions", ray.d, where)
        for a, b in ((other.d, ray.d), (same, weight)):
            self.report.equal("sample_ray_differential() = sample_ray()", a, b, where, (1e-3, 1e-4))
        pixel = np.diag(1 / np.array(sensor.film().crop_size()))
        for step, o, d in (pixel[0], other.o_x, other.d_x), (pixel[1], other.o_y, other.d_y):
            there, _ = rays(sensor.sample_ray, np.float32(film + step[:, None]))
            test, on = "differentials are the rays of the next pixels", rows(other.has_differentials).astype(bool)
            self.report.equal(test, d - ray.d, there.d - ray.d, where, (0.05, 0.05), on=on)
            parallel = on & (rows(there.d) == rows(ray.d))  # the near clip plane moves other origins
            self.report.equal(test, o - ray.o, there.o - ray.o, where, (0.05, 0.05), on=parallel)

    def test_crop(self, sensor: Any) -> None:
        """A crop is a part of the whole."""
        props = self.subject.props
        films = dict.fromkeys(k for k in props if k.startswith("film") or "film" in str(props[k])[:40].lower())
        whole, part = (self.subject.changed(**{**films, "film": mi.load_dict({**FILM, **crop})}) for crop in ({}, CROP))
        if whole is None or part is None:
            return  # it has no such film
        film = uniform(INPUTS, 2, 2)
        there, _ = rays(whole.sample_ray, np.float32([[0.25], [0.2]] + film * [[0.5], [0.4]]))
        self.same_rays("a crop is a part of the whole", part, there, film)

    def same_rays(self, test: str, sensor: Any, expected: Any, film: np.ndarray) -> None:
        """The rays of a sensor are the expected ones."""
        ray, _ = rays(sensor.sample_ray, film)
        for a, b in ((ray.d, expected.d), (ray.o, expected.o)):
            self.report.equal(test, a, b, {"film": film}, (2e-3, 1e-3))

    def test_motion(self, sensor: Any) -> None:
        """With another to_world, rays move along."""
        film = uniform(INPUTS, 2, 2)
        before, after = (self.subject.changed(to_world=one) for one in (mi.ScalarTransform4f(), motion()))
        if before is not None and after is not None:
            ray, _ = rays(before.sample_ray, film)
            self.same_rays("to_world moves rays", after, mi.AffineTransform4f(motion()) @ mi.Ray3f(ray), film)

    def test_projection(self, sensor: Any) -> None:
        """sample_direction() projects a point of a ray to the place of the film from which the ray comes."""
        film = np.float32(0.02 + 0.96 * uniform(INPUTS, 2, 3))
        ray, sent = rays(sensor.sample_ray, film)
        it = interaction(mi.Interaction3f, INPUTS, p=ray(mi.Float(3.0)))
        ds, weight = sensor.sample_direction(it, mi.Point2f(uniform(INPUTS, 3, 1)[1:]))  # the ray's aperture sample
        found, where = (rows(weight, INPUTS) > 0).any(axis=0), {"film": film}
        self.report.require("points of rays are seen", found, where, share=0.02)
        uv = rows(ds.uv, INPUTS) / np.array(sensor.film().crop_size(), dtype=float)[:, None]
        test = "sample_direction() inverts sample_ray()"
        self.report.equal(test, uv, film, where, (5e-3, 1e-4), on=found, share=0.02)
        right, down = slopes(lambda places: rays(sensor.sample_ray, places)[0](mi.Float(3.0)), film, 0.01)
        area = np.abs((np.cross(right, down, axis=0) * rows(ray.d)).sum(axis=0))
        test = "weight of sample_direction() = that of rays"
        self.report.equal(test, rows(weight) * area, sent, where, on=found, share=0.02)

    def inputs(self, n: int) -> list[np.ndarray]:
        """Places on the film and in the aperture."""
        return [uniform(n, 2, 4), uniform(n, 2, 5)]

    def values(self, sensor: Any, film: Any, aperture: Any, wavelengths: Any) -> dict[str, Any]:
        """Rays; without signs, because values are not negative."""
        ray, _ = sensor.sample_ray(mi.Float(0), mi.Float(0.5), film, aperture)
        return {"origins": dr.abs(ray.o), "directions": dr.abs(ray.d)}


class Film(Tests):
    """Tests of a film."""

    def test_energy(self, film: Any) -> None:
        """Samples of the value 1 give pixels of the value 1, and a slope gives the slope; clear() removes them."""
        width, height = film.crop_size()
        corners = np.indices((int(height), int(width)), np.float32)[::-1].reshape(2, -1)
        x = np.tile(corners, 4) + uniform(4 * corners.shape[1], 2)  # four samples in each pixel
        for shape, slope, error in (("constant", 0, 2e-3), ("slope", 1, 3)):
            film.prepare([])
            film.clear()
            block = film.create_block()
            values = [mi.Float(1 + slope * (x[0] + 2 * x[1]))] * (block.channel_count() - 1)
            block.put(mi.Point2f(x + np.array(film.crop_offset())[:, None]), [*values, mi.Float(1)])
            film.put_block(block)
            found = np.array(film.develop(), dtype=float).reshape(corners.shape[1], -1)
            expected = 1 + slope * (corners[0] + 2 * corners[1] + 1.5)
            right = np.abs(found - expected[:, None]).max(axis=1) < error
            self.report.require(f"samples of a {shape} give a {shape}", right, share=0.01)
        film.clear()
        self.report.require("clear() empties the film", [not np.nan_to_num(np.array(film.develop(raw=True))).any()])


class ReconstructionFilter(Tests):
    """Tests of a reconstruction filter."""

    def test_values(self, rfilter: Any) -> None:
        """eval() is symmetric, 0 beyond the radius, and positive on the whole."""
        x = uniform(INPUTS, 1)[0] * rfilter.radius()
        places = x, -x, x + 1.001 * rfilter.radius()
        value, mirrored, beyond = (rows(rfilter.eval(mi.Float(v)), INPUTS) for v in places)
        where = {"x": x}
        self.report.require("eval() is finite", np.isfinite(value), where)
        self.report.equal("eval() is symmetric", mirrored, value, where)
        self.report.require("eval() is 0 beyond radius()", np.abs(beyond) < 1e-5, where)
        self.report.require("the integral is positive", [value.mean() > 0])
        self.report.require("border_size() holds the radius", [rfilter.border_size() >= rfilter.radius() - 0.501])


def draw(sampler: Any, seed: int) -> np.ndarray:
    """Numbers of a sampler, shape (9, n): three of next_1d(), and three pairs of next_2d()."""
    sampler.seed(seed, PIXELS)
    return np.concatenate([rows(draw(), PIXELS) for draw in [sampler.next_1d] * 3 + [sampler.next_2d] * 3])


class Sampler(Tests):
    """Tests of a sampler."""

    def test_numbers(self, sampler: Any) -> None:
        """Numbers lie in [0, 1), have the mean 0.5, repeat with the seed, and change with it; clones continue alike."""
        add, require = self.report.add, self.report.require
        a, b, again = draw(sampler, 0), draw(sampler, 1), draw(sampler, 0)
        require("numbers lie in [0, 1)", (a >= 0) & (a < 1))
        require("the same seed gives the same numbers", a == again)
        require("another seed gives other numbers", [np.mean(a == b) < 0.01])
        correlated = np.corrcoef(a, b) * np.sqrt(PIXELS)
        for i in range(9):
            self.report.mean("numbers have the mean 0.5", a[i], 0.5, 0.5, f"dimension {i}")
            add("seeds are independent", where=f"dimension {i}", p_value=normal_p(correlated[i, i + 9]))
            for j in range(i):
                z = correlated[i, j]  # strata of all pixels may depend on each other
                verdict = FAILS if abs(z) > 0.95 * np.sqrt(PIXELS) else OK if abs(z) < 4 else NOTE
                add("dimensions are independent", verdict, where=f"{j}, {i}", p_value=normal_p(z))
        clone = sampler.clone()
        self.report.equal("a clone continues alike", clone.next_1d(), sampler.next_1d(), worst=NOTE)

    def test_uniform(self, sampler: Any) -> None:
        """next_2d() is uniform in the unit square."""

        def sample(u: Any) -> Any:
            sampler.seed(3, u.shape[1])
            return sampler.next_2d()

        self.report.density("next_2d() is uniform", sample, lambda _: mi.Float(1), dimensions=2)


#: Images of each scene, with other seeds; pixels per side; blocks per side; samples per pixel.
IMAGES, SIDE, BLOCKS, SAMPLES = 32, 12, 3, 16

#: Integrators that trade noise for bias -> relative error of the light of a whole image that is allowed.
BIASED = {"prosim_denoised": 0.02}

#: Variance above that of the reference that is reported.
FACTOR = 4


def scenes() -> Iterator[tuple[str, dict[str, Any], dict[str, Any]]]:
    """Yields the name and the dictionary of scenes, and parameters of the integrator.

    Materials and lamps cross on a floor that is lit directly, below a black ball; a closed room follows if the
    integrator has a ``max_depth``.
    """
    above = mi.ScalarTransform4f().translate([0.3, 0.2, 1.2]).rotate([1, 0, 0], 180).scale(0.3)
    view = mi.ScalarTransform4f().look_at([0, 0.5, 2], [0, 0, 0], [1, 0, 0])
    lamps = {
        "rectangle": {"type": "rectangle", "to_world": above, "emitter": {"type": "area"}},
        "constant": {"type": "constant"},
        "point": {"type": "point", "position": [0.3, 0.2, 1.2]},
        "sphere": {"type": "sphere", "center": [0.3, 0.2, 1.2], "radius": 0.2, "emitter": {"type": "area"}},
        "spot": {"type": "spot", "to_world": view, "cutoff_angle": 30.0},
    }
    materials = {
        "diffuse": {"type": "diffuse", "reflectance": {"type": "checkerboard"}},
        "plastic": {"type": "roughplastic", "alpha": 0.2},
        "rough metal": {"type": "roughconductor", "alpha": 0.3},
        "mask": {"type": "mask", "opacity": 0.6, "nested": {"type": "diffuse"}},
    }
    grey = [{"type": "diffuse", "reflectance": value} for value in (0.0, 0.8)]
    ball = {"type": "sphere", "center": [0.1, 0.1, 0.5], "radius": 0.15, "bsdf": grey[0]}
    for i, (lamp, emitter) in enumerate(lamps.items()):
        for material, bsdf in [*materials.items()][i % 2 :: 2]:
            floor = {"type": "rectangle", "bsdf": bsdf}
            yield f"{material}, {lamp}", {"lamp": emitter, "floor": floor, "ball": ball}, {}
    walls = {"type": "cube", "flip_normals": True, "to_world": mi.ScalarTransform4f().scale(4), "bsdf": grey[1]}
    for limits in {"max_depth": 3}, {"max_depth": 12, "rr_depth": 2}:
        yield f"room, {limits}", {"lamp": lamps["sphere"], "walls": walls}, limits


def images(integrator: Any, things: dict[str, Any], count: int = IMAGES) -> np.ndarray:
    """Means of blocks of independent images, shape (images, blocks); of R, G and B alone."""
    film = {"type": "hdrfilm", "width": SIDE, "height": SIDE, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    view = mi.ScalarTransform4f().look_at([0, -2.5, 2], [0, 0, 0], [0, 0, 1])
    sensor = {"type": "perspective", "fov": 35, "to_world": view, "film": film, "sampler": {"type": "independent"}}
    scene, size = mi.load_dict({"type": "scene", "sensor": sensor, **things}), SIDE // BLOCKS
    found = [np.array(mi.render(scene, integrator=integrator, spp=SAMPLES, seed=7 + i))[..., :3] for i in range(count)]
    return np.array(found).reshape(count, BLOCKS, size, BLOCKS, size, -1).mean(axis=(2, 4, 5)).reshape(count, -1)


class Integrator(Tests):
    """Tests of an integrator."""

    def test_images(self, integrator: Any) -> None:
        """Blocks of images have the means of the reference, and at most four times its variance."""
        add, same, biased = self.report.add, self.report.same_mean, BIASED.get(self.subject.name)
        skies = [{"sky": {"type": "constant", "radiance": v}, "ball": {"type": "sphere"}} for v in (1.0, 3.0)]
        dim, bright = (images(integrator, sky, 1) for sky in skies)
        if np.array_equal(dim, bright):
            raise NotImplementedError("the image does not depend on the light")
        props = self.subject.props
        given = {key: props[key] for key in ("max_depth", "rr_depth", "hide_emitters") if key in props}
        for name, things, limits in scenes():
            if (limited := self.subject.changed(**limits)) is None:
                continue
            a, b = images(limited, things), images(mi.load_dict({"type": "volpath", **given, **limits}), things)
            self.report.require("pixels are finite", np.isfinite(a), name)
            same("images have the light of volpath", a.sum(axis=1), b.sum(axis=1), name, biased or 1e-4)
            if biased:
                words = f"it may move light between pixels; {biased:.0%} in all"
                add("blocks have the light of volpath", SKIPPED, words)
                continue
            for i in range(BLOCKS**2):
                same("blocks have the light of volpath", a[:, i], b[:, i], f"{name}, block {i}")
            factor = float(a.var(axis=0).mean() / max(b.var(axis=0).mean(), 1e-12 + 1e-6 * b.mean() ** 2))
            verdict = NOTE if factor > FACTOR else OK
            add("variance is at most 4 times that of volpath", verdict, f"{factor:.2f} times", name)
