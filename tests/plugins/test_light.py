"""Sources as surfaces sample and meet them: overhead, far from the origin, tiny (sections 4.2.2.1, 5.2)."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from image_statistics import renderings
from mitsuba_prosim.light.spheres import direction_to_sphere
from mitsuba_prosim.light.strategy import Receiver
from scenes import T, camera, film, grid, ground, load_scene, sphere_lamp


@pytest.mark.slow
@pytest.mark.parametrize("normal", [(0, 1, 0), (0.48, 0.64, 0.6), (1, 0, 0)])
@pytest.mark.parametrize("radius", [1.0, 0.01])
def test_a_ball_overhead_is_sampled_where_it_is(variant_rgb, normal, radius):
    """At every angle from the normal: unit directions that meet the ball, and its irradiance pi L (r/d)² cos."""
    for aside in (0, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3):
        check_ball(np.array(normal, dtype=float), aside, radius)


def check_ball(normal, aside, radius):
    across = np.cross(normal, [0.3, 0.1, 0.9])
    distance = 5.0
    center = distance * (normal * np.cos(aside) + across / np.linalg.norm(across) * np.sin(aside))
    sample = grid(128)
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(sample))
    receiver = Receiver(si, mi.Normal3f(*normal.tolist()))
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
