"""The rays of translated cameras against the formula of the language, and degenerate views."""

import mitsuba as mi
import numpy as np
import prosim_scene
import pytest

pytestmark = pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")

VIEWS = {
    "palito": "RESOLUTION 500 500 WINDOW -18. -22. 16. 12. OBS 0 8 30 VPN 0 0 0 VRP 0 8 10 - VUP 0 1 0",
    "oblique": "RESOLUTION 320 200 WINDOW -3 1 5 6 OBS 4 7 20 VPN 1 .5 2 VRP 1 2 -3 VUP .2 1 .1",
    "turned": "RESOLUTION 64 64 WINDOW 0 0 1 1 OBS 100 -2 3 VPN -1 0 .2 VRP 90 0 0 VUP 0 0 1",
    "tall pixels": "RESOLUTION 400 100 WINDOW -2 -1.5 2 1 OBS 0 1 9 VPN .3 0 1 VRP 0 0 0 VUP 0 1 0",
    "wide": "RESOLUTION 300 150 WINDOW -40 -20 40 20 OBS 0 0 5 VRP 0 0 0 VUP 0 1 0",
}
VIEWED = "VIEW {} LIGHTS POINT position 0 0 0 CSG-TREE END"


def formula(view, i, j):
    """Directions of the pixels (i, j) as the language defines them."""
    e, p, n, up = (np.array(x) for x in (view.eye, view.vrp, view.vpn, view.vup))
    n = n if n.any() else e - p
    n = n / np.linalg.norm(n)
    n = n if (e - p) @ n > 0 else -n
    u = np.cross(up, n)
    u /= np.linalg.norm(u)
    v = np.cross(n, u)
    umin, vmin, umax, vmax = view.window
    width, height = (umax - umin) / view.resolution[0], (vmax - vmin) / view.resolution[1]
    through = p + np.multiply.outer(umin + (i + 0.5) * width, u) + np.multiply.outer(vmax - (j + 0.5) * height, v)
    return through, e, min(width, height), n, p


def translated(path, **options):
    """The sensor of a scene with nothing but a view, and the view."""
    sensor = prosim_scene.load(path, light_units="radiance", **options)["view"]
    del sensor["sampler"]
    return mi.load_dict(sensor), prosim_scene.parse(path.read_text()).view


def rays(sensor, view, pixels, on_lens):
    """Origins and directions of rays through pixels, sampled in both ways, and what the formula gives."""
    position = mi.Point2f((pixels + 0.5) / np.reshape(view.resolution, (2, 1)))
    for sample in (sensor.sample_ray, sensor.sample_ray_differential):
        ray, _ = sample(0, 0.5, position, on_lens)
        yield np.array(ray.o, dtype=float).T, np.array(ray.d, dtype=float).T, formula(view, *pixels)


@pytest.mark.parametrize("name", VIEWS)
def test_rays_are_exact(name, write_scene, variant_rgb):
    sensor, view = translated(write_scene(VIEWED.format(VIEWS[name])))
    w, h = view.resolution
    corners = [[0, 0], [w - 1, 0], [0, h - 1], [w - 1, h - 1]]
    pixels = np.concatenate([corners, np.random.default_rng(3).integers(0, (w, h), (200, 2))]).T
    for o, d, (through, eye, pixel, n, vrp) in rays(sensor, view, pixels, mi.Point2f(0.5)):
        # Where the ray meets the view plane, against the point that it should go through, in pixels.
        t = ((vrp - o) @ n) / (d @ n)
        assert (np.linalg.norm(o + t[:, None] * d - through, axis=1) / pixel).max() < 1e-3
        assert np.linalg.norm(np.cross(eye - o, d), axis=1).max() < 1e-4 * np.linalg.norm(eye)  # through the eye
    assert tuple(sensor.film().size()) == (w, h)


LENSES = {
    "centred": "RESOLUTION 300 150 WINDOW -4 -2 4 2 OBS 0 0 5 VRP 0 0 0 VUP 0 1 0 APERTURE .5",
    "oblique": VIEWS["oblique"] + " APERTURE .5 FOCUS 9",
    "tall pixels": VIEWS["tall pixels"] + " ABERTURA .2 FOCO 4",
}


@pytest.mark.parametrize("name", LENSES)
def test_rays_from_the_lens_meet_in_the_plane_of_focus(name, write_scene, variant_rgb):
    """Where the pinhole's ray meets this plane; the lens is a disc around the eye, parallel to the view plane."""
    sensor, view = translated(write_scene(VIEWED.format(LENSES[name])))
    assert sensor.needs_aperture_sample()
    pixels, on_lens = np.random.default_rng(4).integers(0, 100, (2, 500)), np.random.default_rng(5).random((2, 500))
    for o, d, (through, eye, pixel, n, vrp) in rays(sensor, view, pixels, mi.Point2f(on_lens)):
        depth = (eye - vrp) @ n
        focus = view.focus or depth
        sharp = eye + (through - eye) * (focus / depth)
        t = ((sharp - o) @ n[:, None])[:, 0] / (d @ n)
        assert np.linalg.norm(o + t[:, None] * d - sharp, axis=1).max() < 1e-3 * pixel * focus / depth
        lens = o - d * ((o - eye) @ n / (d @ n))[:, None]
        radius = np.linalg.norm(lens - eye, axis=1)
        assert radius.max() <= view.aperture * (1 + 1e-5) and radius.min() < 0.2 * view.aperture
        assert np.mean((radius / view.aperture) ** 2) == pytest.approx(0.5, abs=0.05)  # evenly over the disc


def test_stock_lens_has_the_rays_of_the_window(write_scene, variant_rgb):
    path = write_scene(VIEWED.format(LENSES["centred"]))
    own, _ = translated(path)
    stock, _ = translated(path, target="stock")
    assert stock.class_name() == "ThinLensCamera"
    points = np.random.default_rng(4).random((4, 500))
    a, b = (s.sample_ray(0, 0.5, mi.Point2f(points[:2]), mi.Point2f(points[2:]))[0] for s in (own, stock))
    assert np.abs(np.array(a.d) - b.d).max() < 1e-5 and np.abs(np.array(a.o) - b.o).max() < 1e-5


@pytest.mark.parametrize("target", ["prosim", "stock"])
def test_file_of_a_scene_has_the_lens(target, write_scene, variant_rgb, tmp_path):
    tree = "+ + CONE 0 radius .5 TORUS 0 radius .2 PLANE 0 SURFACE 0 TRANSFORM 0 MATRIX 1 0 0 0 0 1 0 0 0 0 1 1"
    path = write_scene(f"VIEW {LENSES['centred']} LIGHTS POINT position 0 0 9 CSG-TREE {tree} END")
    scene = mi.load_file(str(prosim_scene.translate(path, tmp_path / target, target=target)))
    params = mi.traverse(scene.sensors()[0]) if target == "stock" else vars(scene.sensors()[0])
    assert params["aperture_radius"] == 0.5 and params["focus_distance"] == 5


def test_stock_says_that_an_off_centre_window_has_no_lens(write_scene, variant_rgb):
    view = VIEWS["turned"] + " APERTURE .5"
    with pytest.warns(prosim_scene.SceneWarning, match="APERTURE has no effect if the window is not centred"):
        sensor, _ = translated(write_scene(VIEWED.format(view)), target="stock")
    assert sensor.class_name() == "PerspectiveCamera"


@pytest.mark.parametrize("eye, vpn", [("0 0 20", "0 0 0"), ("3.7 4.1 9.3", "0 0 0"), ("1 2 3", "1 2 3")])
def test_another_sensor_of_mitsuba_reads_a_centred_view(eye, vpn, write_scene, variant_rgb):
    sensor = prosim_scene.load(write_scene(VIEWED.format(f"EYE {eye} VPN {vpn}")), light_units="radiance")["view"]
    del sensor["sampler"]
    lens = mi.load_dict(sensor | {"type": "thinlens", "aperture_radius": 0.1, "focus_distance": 20})
    assert lens.class_name() == "ThinLensCamera"


def test_warning_names_focus_without_aperture(write_scene):
    with pytest.warns(prosim_scene.SceneWarning, match="FOCUS has no effect without APERTURE; add it"):
        prosim_scene.check(write_scene(f"VIEW FOCUS 3 LIGHTS POINT position 0 9 9 CSG-TREE {BALL} END"))


def test_stock_views_have_square_pixels_and_say_so(write_scene, variant_rgb):
    with pytest.warns(prosim_scene.SceneWarning, match="pixels are square, 400x250 of them instead of 400x100"):
        sensor, _ = translated(write_scene(VIEWED.format(VIEWS["tall pixels"])), target="stock")
    assert sensor.class_name() == "PerspectiveCamera" and tuple(sensor.film().size()) == (400, 250)


@pytest.mark.parametrize(
    "given, word, others",
    [
        ("RESOLUTION 300 400 WINDOW -4 -3 4 3", "RESOLUTION", "300x225 or 533x400"),
        ("WINDOW -4 -3 4 3", "WINDOW", "500x375 or 667x500"),
        ("RESOLUTION 400 300", "RESOLUTION", "400x400 or 300x300"),
        ("RESOLUTION 520 240 WINDOW -12.4 -5.2 12.4 6.2", "", ""),  # by less than a hundredth
        ("WINDOW -9 -9 9 9", "", ""),
    ],
)
def test_warning_names_a_distorted_window(given, word, others, write_scene, recwarn):
    """By prosim_scene alone for the scene's own numbers: others are told who asks for them."""
    scene = write_scene(f"LIGHTS POINT position 0 9 9\nVIEW {given}\nCSG-TREE CUBE 0 SURFACE 0 TRANSFORM 0 END\n")
    prosim_scene.check(scene, resolution=(300, 400))
    prosim_scene.check(scene, target="stock")
    assert not any("pixels distort" in str(w.message) for w in recwarn)
    recwarn.clear()
    prosim_scene.check(scene)
    said = [str(w.message) for w in recwarn]
    assert len(said) == bool(word)
    if word:
        assert f"pixels distort the image of the scene's window; {others} would not" in said[0]
        assert said[0].splitlines()[1][said[0].splitlines()[2].index("^") :].startswith(word)


def test_window_sensor_and_crop(variant):
    film = {"type": "hdrfilm", "width": 30, "height": 20, "filter": {"type": "box"}}
    crop = {"crop_offset_x": 6, "crop_offset_y": 5, "crop_width": 15, "crop_height": 10}
    window = {"type": "prosim_window", "left": -0.3, "right": 1.2, "bottom": -2, "top": 0.5}
    expected = np.array([0.3 - 1.5 * (6 + 0.25 * 15) / 30, 0.5 - 2.5 * 0.5, 1])
    for more, at in ({}, [(6 + 0.25 * 15) / 30, (5 + 0.5 * 10) / 20]), (crop, [0.25, 0.5]):
        ray, _ = mi.load_dict({**window, "film": film | more}).sample_ray(0, 0.5, mi.Point2f(at), mi.Point2f(0))
        assert np.allclose(np.array(ray.d).ravel(), expected / np.linalg.norm(expected), atol=1e-6)


def test_solid_before_the_edge_of_a_lens_is_not_clipped(write_scene):
    """It is nearer to the lens than the usual near plane, but not near to the eye in its middle."""
    view = "VIEW EYE 0 0 1000 APERTURE 4 LIGHTS POINT position 0 0 90"
    path = write_scene(f"{view} CSG-TREE CUBE 0 SURFACE 0 TRANSFORM 0 TRANSLATE (2 0 998.5) END")
    assert prosim_scene.load(path)["view"]["near_clip"] < 0.5


BALL = "SPHERE 0 SURFACE 0 ka .5 kd 0 TRANSFORM 0"
CUBE = "CUBE 0 SURFACE 0 ka .5 kd 0 TRANSFORM 0"
ROOM = "SURFACE 1 TRANSFORM 1 SCALE (4 4 4) TRANSLATE (-2 -2 -2)"
CLIPPED = {
    "far view plane": ("-15010 -15010 15010 15010 OBS 0 0 20 VRP 0 0 -30000", f"{BALL} SCALE (5 5 5)"),
    "near view plane": ("-5e-5 -5e-5 5e-5 5e-5 OBS 0 0 20 VRP 0 0 19.9999", f"{BALL} SCALE (5 5 5)"),
    "a wall far behind": ("-1 -1 1 1 OBS 0 0 1", f"{CUBE} SCALE (1e7 1e7 1) TRANSLATE (-5e6 -5e6 -1e6)"),
    "a floor": ("-900 -900 900 900 OBS 0 .01 0 VRP 0 0 -500", f"{CUBE} SCALE (200 1 200) TRANSLATE (-100 -1 -100)"),
    "the eye in a room": ("-900 -900 900 900 OBS 0 0 .999 VRP 0 0 -500", f"- CUBE 1 {BALL} {ROOM}"),
}


@pytest.mark.parametrize("target", ["prosim", "stock"])
@pytest.mark.parametrize("name", CLIPPED)
def test_nothing_is_clipped(name, target, write_scene, variant_rgb):
    """The camera's rays meet all that rays without an end meet, which begin at the eye itself."""
    view, tree = CLIPPED[name]
    path = write_scene(f"VIEW RESOLUTION 40 40 WINDOW {view} LIGHTS POINT position 0 0 90 CSG-TREE {tree} END")
    scene = mi.load_dict(prosim_scene.load(path, target=target, tolerance=1))
    j, i = np.mgrid[:40, :40]
    position = mi.Point2f(((i + 0.5) / 40).ravel(), ((j + 0.5) / 40).ravel())
    ray, _ = scene.sensors()[0].sample_ray(0, 0.5, position, mi.Point2f(0.5))
    seen = np.array(scene.ray_intersect(ray).is_valid())
    whole = mi.Ray3f(mi.Point3f(prosim_scene.parse(path.read_text()).view.eye), ray.d)
    expected = np.array(scene.ray_intersect(whole).is_valid())
    assert expected.any() and np.array_equal(seen, expected)
