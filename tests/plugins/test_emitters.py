"""The emitters: against Mitsuba's own and closed forms; what surfaces sample and meet (sections 4.2.2.1, 5.2)."""

import itertools

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from image_statistics import renderings
from mitsuba_prosim.compat import to_world_name
from mitsuba_prosim.light.strategy import Receiver, direction_to_sphere
from scenes import T, bitmap, camera, derivative, diffuse, film, grid, ground, load_scene, rgb, sphere_lamp

CENTRE, RADIUS = [1.5, 3.0, 1.0], 0.4
CONE = {"distribution": "cone", "angle": 25.0, "direction": [-1, -2, 0]}
SPOT = {"distribution": "spot", "exponent": 6.0, "angle": 60.0, "direction": [-1, -2, 0]}


def sphere(emitter, radius=RADIUS):
    return {"type": "sphere", "center": CENTRE, "radius": radius, "emitter": emitter}


def surface(**parameters):
    return {"type": "prosim_area", "radiance": rgb(20, 15, 10), **parameters}


def point(**parameters):
    return {"type": "prosim_point", "position": CENTRE, "intensity": rgb(20, 15, 10), **parameters}


def source_of(make, **parameters):
    """A point, or a sphere with that surface."""
    return sphere(surface(**parameters)) if make is surface else make(**parameters)


def scene(source, integrator="path", size=16, samples=64, **options):
    """A ball over a floor; the source may be in view."""
    sampler = {"type": "independent", "sample_count": samples}
    return load_scene(
        integrator={"type": integrator, **options},
        sensor=camera([0, 2.5, 6], [0, 1, 0], film(size), fov=45, sampler=sampler),
        floor=ground(4, diffuse(0.6, 0.6, 0.5)),
        ball={"type": "sphere", "center": [0, 0.8, 0], "radius": 0.8, "bsdf": diffuse(0.2, 0.5, 0.8)},
        source=source,
    )


def image(*args, seed=0, **options):
    return np.array(mi.render(scene(*args, **options), seed=seed))


def emitter_of(source):
    """The scene (to keep it alive) and its emitter, which is seen by the surface at the origin that faces up."""
    loaded = mi.load_dict({"type": "scene", "source": source})
    return loaded, loaded.emitters()[0]


def receiver(p=(0, 0, 0), n=1):
    it = dr.zeros(mi.SurfaceInteraction3f, n)
    it.p = mi.Point3f(p)
    return it


def first(value):
    """The colour of the first lane."""
    return np.array(value).reshape(3, -1)[:, 0]


@pytest.mark.slow
def test_a_moved_texture_lights_with_all_of_its_points(variant_rgb, logged):
    """Mitsuba's ``area`` samples such a texture as if it were not moved: ``prosim_adaptive`` warns of it."""
    radiance = {"filter_type": "nearest", "to_uv": mi.ScalarTransform3f().scale([2, 1])} | bitmap([[[0] * 3, [4] * 3]])
    place = {"type": "rectangle", "id": "lamp", "to_world": T().translate(CENTRE).rotate([1, 0, 0], 90)}
    direct, ours, theirs = (
        image(place | {"emitter": {"type": name, "radiance": radiance}}, kind, samples=1024, hide_emitters=True).mean()
        for kind, name in (("direct", "area"), ("prosim", "prosim_area"), ("prosim", "area"))
    )
    assert [ours, theirs] == pytest.approx([direct, direct], rel=0.03) and not logged
    image(place | {"emitter": {"type": "area", "radiance": radiance}}, "prosim_adaptive", samples=1, i={"type": "path"})
    assert ["'lamp'" in text and "prosim_area" in text for _, text in logged] == [True]


# Physics


def around(angle):
    """A receiver at distance 2 of CENTRE, at an angle in degrees from the axis of CONE and SPOT."""
    axis = np.array([-1.0, -2.0, 0.0]) / np.sqrt(5)
    side = np.array([2.0, -1.0, 0.0]) / np.sqrt(5)
    return CENTRE + 2 * (np.cos(np.deg2rad(angle)) * axis + np.sin(np.deg2rad(angle)) * side)


@pytest.mark.parametrize("direction", ([1e-7, 0, -1], [1, 2, 3]), ids=str)
@pytest.mark.parametrize(
    "parameters",
    (
        {"distribution": "cone", "angle": 180.0},
        {"distribution": "cone", "angle": 1e-3},
        {"distribution": "spot", "exponent": 1e6},
        {"distribution": "spot", "exponent": 7.0},
        {"distribution": "spot", "exponent": 0.0, "angle": 0.05},
    ),
    ids=str,
)
def test_narrow_beams(variant_rgb, parameters, direction):
    """Power, profile and directions as in double precision, however narrow the beam and wherever it points."""
    _scene, emitter = emitter_of({"type": "prosim_point", "direction": direction, **parameters})
    axis = np.array(mi.Vector3f(direction), dtype=float).ravel()
    axis /= np.linalg.norm(axis)
    n, widest = parameters.get("exponent", 0.0), np.radians(parameters.get("angle", 90.0))
    v = 2 * np.sin(widest / 2) ** 2
    power = 2 * np.pi * v if n == 0 else 2 * np.pi * -np.expm1((n + 1) * np.log1p(-min(v, 1 - 1e-16))) / (n + 1)
    ray, weight = emitter.sample_ray(0.0, 0.5, mi.Point2f(0.5), grid(64))
    assert first(weight)[0] == pytest.approx(power, rel=1e-4)
    d = np.array(ray.d, dtype=float)
    np.testing.assert_allclose(np.linalg.norm(d, axis=0), 1, atol=1e-6)
    angle = 2 * np.arcsin(np.clip(0.5 * np.linalg.norm(d - axis[:, None], axis=0), 0, 1))
    assert angle.max() <= widest * (1 + 1e-3) + 1e-6
    if widest < 1:  # the mean of the squared angle is half the greatest
        assert (angle**2).mean() == pytest.approx(widest**2 / 2, rel=0.02, abs=1e-11)
    else:  # of all the sphere, or of a lobe
        versine = 1 if n == 0 else 1 / (n + 2)
        assert (2 * np.sin(angle / 2) ** 2).mean() == pytest.approx(versine, rel=0.02)
    ds = dr.zeros(mi.DirectionSample3f, d.shape[1])
    ds.d = -ray.d
    stated = np.array(emitter.eval_direction(receiver(ray.d, d.shape[1]), ds), dtype=float)[0]
    inside = angle < widest * (1 - 1e-3) - 1e-6
    np.testing.assert_allclose(stated[inside], np.cos(angle[inside]) ** n, rtol=5e-3)


# The mode of 1992


@pytest.mark.parametrize("distance", (0.5, 2.0, 50.0))
def test_unattenuated_irradiance(variant_rgb, distance):
    """The same at any distance, for a sphere up to its finite size, and exactly for a point."""
    for source in (
        {"type": "sphere", "center": [0, distance, 0], "radius": 0.1, "emitter": surface(unattenuated=True)},
        point(unattenuated=True) | {"position": [0, distance, 0]},
    ):
        _scene, emitter = emitter_of(source)
        ds, weight = emitter.sample_direction(receiver(n=64 * 64), grid(64))
        irradiance = np.array(dr.mean(weight * ds.d.y, axis=1)).ravel()
        assert np.allclose(irradiance, [20, 15, 10], rtol=1e-3)


@pytest.mark.parametrize("beam", ({}, CONE, SPOT), ids=("uniform", "cone", "spot"))
def test_unattenuated_source_is_evaluated_as_it_is_sampled(variant_rgb, beam):
    """By ``eval_direction``, and by ``eval`` where a ray meets it."""
    loaded, emitter = emitter_of(sphere(surface(unattenuated=True, **beam)))
    it = receiver(around(20), 32 * 32)
    ds, weight = emitter.sample_direction(it, grid(32))
    si = loaded.ray_intersect(mi.Ray3f(it.p, ds.d))
    stated, hit = np.array(emitter.eval_direction(it, ds)), np.array(si.is_valid())
    assert stated.max() > 0 and hit.mean() > 0.99
    assert np.allclose(np.array(weight * ds.pdf), stated, rtol=1e-4)
    assert np.allclose(np.array(emitter.eval(si))[:, hit], stated[:, hit], rtol=2e-3)


@pytest.mark.parametrize("make", (surface, point))
def test_unattenuated_has_no_particles(variant_rgb, make):
    _scene, emitter = emitter_of(source_of(make, unattenuated=True))
    with pytest.raises(RuntimeError, match="unattenuated"):
        emitter.sample_ray(0, 0.5, [0.5, 0.5], [0.5, 0.5])


# Derivatives and parameters


@pytest.mark.parametrize("make", (surface, point))
def test_derivative_by_direction_matches_finite_difference(variant_rgb, make):
    _scene, emitter = emitter_of(source_of(make, **SPOT))
    params, it, h = mi.traverse(emitter), receiver(around(20)), 0.01

    def light(shift):
        params["direction"] = mi.Vector3f(-1, -2, 0) + mi.Vector3f(shift, 0, 0)
        params.update()
        return emitter.sample_direction(it, mi.Point2f(0.5))[1].x

    difference = (light(h) - light(-h))[0] / (2 * h)
    assert abs(difference) > 0.1 and derivative(light) == pytest.approx(difference, rel=0.01)


@pytest.mark.parametrize("shape", ("sphere", "rectangle"))
def test_derivative_of_an_unattenuated_source_by_its_place(variant_rgb, shape):
    """The radiance grows with the squared distance of the receiver."""
    source = {"type": shape, "to_world": T().translate(CENTRE), "emitter": surface(unattenuated=True)}
    loaded, emitter = emitter_of(source)
    params, ds = mi.traverse(loaded), dr.zeros(mi.DirectionSample3f)
    name = to_world_name(params, "source.")
    to_world = type(params[name])(params[name])
    ds.d = dr.normalize(mi.Vector3f(CENTRE))
    ds.n = -ds.d

    def radiance(further):
        params[name] = mi.Transform4f().translate(mi.Vector3f(CENTRE) * further) @ to_world
        params.update()
        return emitter.eval_direction(receiver(), ds).x

    assert derivative(radiance) == pytest.approx(2 * radiance(mi.Float(0))[0], rel=1e-4)


def test_density_of_a_sphere_needs_no_point(variant_rgb):
    """It is uniform over the solid angle of the sphere; a direction that moves with the sphere has no point."""
    _scene, emitter = emitter_of(sphere(surface()))
    p, ds = np.array([3.0, 0.0, 0.0]), dr.zeros(mi.DirectionSample3f)
    ds.d = dr.normalize(mi.Vector3f(CENTRE - p))
    ds.n = -ds.d
    cos = np.sqrt(1 - RADIUS**2 / np.sum(np.square(CENTRE - p)))
    assert emitter.pdf_direction(receiver(p), ds)[0] == pytest.approx(1 / (2 * np.pi * (1 - cos)), rel=1e-4)


def test_equal_sources_stay_two(variant_rgb):
    assert len(load_scene(a=point(), b=point()).emitters()) == 2


BLACK = {"number": (0.0, 5.0), "colour": (rgb(0, 0, 0), rgb(5, 5, 5))}
BLACK["spectrum"] = tuple({"type": "spectrum", "value": [(300.0, v), (900.0, v)]} for v in (0.0, 5.0))


@pytest.mark.parametrize("kind", BLACK)
@pytest.mark.parametrize("make", (surface, point))
def test_black_source_takes_a_value_later(variant_spectral, make, kind):
    """Set to a value, it shines as one that is loaded with it."""
    quantity = "radiance" if make is surface else "intensity"
    (_black, emitter), (_loaded, shining) = (emitter_of(source_of(make, **{quantity: value})) for value in BLACK[kind])
    it = receiver()
    it.wavelengths = mi.UnpolarizedSpectrum(450, 500, 550, 650)
    dark, bright = (lambda e=e: np.array(e.sample_direction(it, mi.Point2f(0.3, 0.6))[1]) for e in (emitter, shining))
    assert np.all(dark() == 0)
    params = mi.traverse(emitter)
    params[f"{quantity}.value"] = 5.0
    params.update()
    np.testing.assert_allclose(dark(), bright(), rtol=1e-5)


def test_bitmaps_that_mitsuba_takes_for_reflectances_are_warned_of(variant_spectral, logged):
    """Their light above 1 is lost, and that of 1 is not white; with an illuminant it is that of a colour."""
    image = {"type": "bitmap", "bitmap": mi.Bitmap(np.full((2, 2, 3), 0.5, np.float32))}
    for background in rgb(0.5, 0.5, 0.5), {"type": "d65", "nested": image}, image:
        integrator = {"type": "prosim", "background": background}
        empty = load_scene(sensor=camera([0, 0, 5], [0, 0, 0], film(4)), integrator=integrator)
        is_white = np.allclose(np.mean(mi.render(empty, spp=64), (0, 1)), 0.5, atol=0.01)
        assert is_white == (background is not image) == (not logged)


@pytest.mark.parametrize("texel", (-1.0, float("nan"), float("inf")))
def test_an_image_of_light_is_finite_and_not_negative(variant_rgb, texel):
    texels = np.ones((3, 3, 3), np.float32)
    texels[1, 1, 2] = texel
    for radiance in (bitmap(texels), {"type": "prosim_product", "a": bitmap(texels)}):
        with pytest.raises(Exception, match=r'parameter "radiance" is .*data has .*; allowed: finite numbers >= 0'):
            mi.load_dict(sphere(surface(radiance=radiance)))


def test_textures_of_light_are_accepted(variant):
    """Also where their numbers become coefficients of spectra, which may be negative."""
    texels = mi.TensorXf(np.random.default_rng(1).random((3, 3, 3)).astype(np.float32))
    for texture in (
        {"type": "prosim_brick", "brick": rgb(0.2, 0.4, 0.9), "mortar": 3.0},
        {"type": "bitmap", "data": texels},
        {"type": "blackbody", "temperature": 3000.0},
    ):
        loaded, _ = emitter_of(sphere(surface() | {"radiance": texture}))
        assert len(loaded.emitters()) == 1


# Overhead, far from the origin, tiny


@pytest.mark.slow
@pytest.mark.parametrize("aside", (0, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3))
def test_ball_lamp_overhead_has_the_right_irradiance(variant_rgb, aside):
    """At an angle from the normal: unit directions that meet the ball, and its irradiance pi L (r/d)² cos."""
    sample, distance = grid(128), 5.0
    for normal, radius in itertools.product(((0, 1, 0), (0.48, 0.64, 0.6), (1, 0, 0)), (1.0, 0.01)):
        normal, across = np.array(normal, dtype=float), np.cross(normal, [0.3, 0.1, 0.9])
        center = distance * (normal * np.cos(aside) + across / np.linalg.norm(across) * np.sin(aside))
        receiver = Receiver(dr.zeros(mi.SurfaceInteraction3f, dr.width(sample)), mi.Normal3f(*normal.tolist()))
        ds = direction_to_sphere(receiver, mi.Point3f(*center.tolist()), mi.Float(radius), sample)
        d, pdf = np.array(ds.d, dtype=float), np.array(ds.pdf, dtype=float)
        assert np.abs(np.linalg.norm(d, axis=0) - 1).max() < 1e-6
        beside = np.linalg.norm(np.cross(d.T, center), axis=1)
        assert beside.max() < radius * (1 + 1e-3) + 1e-5
        assert np.mean(normal @ d / pdf) == pytest.approx(np.pi * (radius / distance) ** 2 * np.cos(aside), rel=1e-4)


@pytest.mark.parametrize("height, aside", [(1e5, 0), (1e5, 3e4), (1e3, 0)])
def test_a_sun_lights_every_pixel_of_a_floor_alike(variant_rgb, height, aside):
    """Irradiance pi on a white floor: radiance 1, less by the cube of the cosine where the sun stands aside."""
    scene = load_scene(
        integrator={"type": "prosim", "adaptive": "none", "max_level": 0},
        sensor={"type": "orthographic", "to_world": T().look_at([0, 3, 0], [0, 0, 0], [0, 0, 1]), "film": film(16)},
        floor=ground(2, {"type": "diffuse", "reflectance": 1.0}),
        sun=sphere_lamp([aside, height, 0.0], 0.005 * height, 1 / 0.005**2),
    )
    image = np.array(mi.render(scene, spp=64))
    expected = (1 + (aside / height) ** 2) ** -1.5
    assert np.allclose(image, expected, rtol=1e-3)


def lamp_beside_a_floor(offset, bsdf, **integrator):
    def at(*p):
        return [float(a + b) for a, b in zip(offset, p)]

    return {
        "type": "scene",
        "integrator": integrator,
        "sensor": camera(at(0, 1, 2), at(0, 0, 0.05), film(16), fov=10),
        "floor": {"type": "rectangle", "to_world": T().translate(at(0, 0, 0)).rotate([1, 0, 0], -90), "bsdf": bsdf},
        "light": sphere_lamp(at(0, 0.1, -0.2), 0.02, 100.0),
    }


@pytest.mark.slow
@pytest.mark.parametrize("bsdf", [{"type": "conductor"}, {"type": "roughconductor", "alpha": 0.05}])
def test_a_small_lamp_near_a_mirror_shines_far_from_the_origin_too(variant_rgb, bsdf):
    """Rays that could have met the lamp are not given up: as bright at (100, 50, 30) as at the origin."""
    settings = {"type": "prosim", "max_level": 0, "adaptive": "none", "hide_emitters": True}
    here, there = (
        renderings(lamp_beside_a_floor(offset, bsdf, **settings), 8, spp=100).mean((1, 2, 3))
        for offset in ((0, 0, 0), (100, 50, 30))
    )
    error = np.hypot(here.std(ddof=1), there.std(ddof=1)) / np.sqrt(8)
    # Mitsuba's rays start 0.009 off the surface there, which brightens a rough one by some per cent.
    assert -4 * error < there.mean() - here.mean() < 4 * error + 0.08 * here.mean()


def test_a_lamp_that_grows_from_nothing_lights_as_a_new_one(variant_rgb):
    """Nothing samples a shape without area; the first render had found that out for the later ones."""
    up, integrator = T().translate([0, 3, 0]).rotate([1, 0, 0], 90), mi.load_dict({"type": "path", "max_depth": 2})

    def scene(scale):
        return load_scene(
            sensor=camera([0, 1.5, 7], [0, 0.5, 0], film(4)),
            floor=ground(3, diffuse(0.8, 0.8, 0.8)),
            lamp={"type": "rectangle", "to_world": up.scale(scale), "emitter": {"type": "prosim_area"}},
        )

    grown = scene(1e-30)
    params = mi.traverse(grown)
    assert not np.any(mi.render(grown, integrator=integrator, spp=16))
    params["lamp.to_world"] = mi.AffineTransform4f(up.matrix)
    params.update()
    images = [mi.render(each, integrator=integrator, spp=16) for each in (grown, scene(1))]
    assert np.array_equal(*images) and np.any(images)
