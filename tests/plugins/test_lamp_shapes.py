"""Lamps on shapes and with textures that Mitsuba samples wrongly or not at all: their light, photons and messages."""

import itertools

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from mitsuba_prosim.light.emitter_methods import EmitterMethods
from scenes import UV, T, area, bitmap, camera, diffuse, film, ground, load_scene, rgb, shape_of, slow, write_square

PLUGINS = ("area", "prosim_area")
#: Texture coordinates of a square mesh: in the unit square, or outside it, or missing.
COORDINATES = {"unit": UV, "tiled": 3 * UV, "none": None}
UNSAMPLED = ("sdfgrid", "ellipsoids", "bsplinecurve", "linearcurve")
DIRECT = {"type": "prosim", "adaptive": "none", "max_level": 0, "hide_emitters": True}
PATHS = {**DIRECT, "diffuse_bounces": -1}
ROUGH_GLASS = {"type": "roughdielectric", "alpha": 0.4}


def above():
    """Where lamps are, which face down."""
    return T().translate([0, 2, 0]).rotate([1, 0, 0], 90)


def lit(lamp, floor=None, **things):
    """A floor under a lamp, which faces down."""
    return load_scene(
        sensor=camera([0, 3, 5], [0, 0, 0], film(8), fov=40),
        floor=ground(4, floor or diffuse(0.8, 0.8, 0.8)),
        lamp=lamp if lamp["type"] == "ellipsoids" else {"to_world": above(), **lamp},
        **things,
    )


def mean(scene, integrator, spp=1024, count=8):
    """The mean of some images, and its standard error."""
    made = mi.load_dict(integrator)
    means = [np.array(made.render(scene, seed=seed, spp=spp)).mean() for seed in range(count)]
    return np.mean(means), np.std(means, ddof=1) / np.sqrt(count)


def textured(case, folder, value=3.0):
    """A shape, and a radiance that is ``value`` everywhere."""
    shape = write_square(folder / "square.ply", COORDINATES.get(case), color=value if case == "attribute" else None)
    texture = bitmap(np.full((4, 4, 3), value))
    radiance = {"type": "mesh_attribute", "name": "vertex_color"} if case == "attribute" else texture
    return shape, radiance


@pytest.mark.slow
def test_bright_spot_is_sampled_by_the_texture(variant_rgb, tmp_path):
    """The noise is much less than on a mesh, which is sampled evenly."""
    texels = np.zeros((16, 16, 3))
    texels[3, 5] = 100
    lamp = {"type": "area", "radiance": bitmap(texels, filter_type="nearest")}
    noise = {}
    for name, shape in ("rectangle", {"type": "rectangle"}), ("mesh", textured("unit", tmp_path)[0]):
        value, error = mean(lit(shape | {"emitter": lamp}), DIRECT, spp=16)
        noise[name] = error / value
    assert noise["rectangle"] < 0.2 * noise["mesh"]


@pytest.mark.parametrize("case", ["sdfgrid", "bsplinecurve", "attribute"])
def test_lamp_without_sampling_refuses_particle_tracing(variant_rgb, tmp_path, case):
    shape, radiance = textured(case, tmp_path) if case == "attribute" else (shape_of(case, tmp_path), rgb(1, 2, 3))
    scene = lit(shape | {"emitter": {"type": "prosim_area", "radiance": radiance}})
    with pytest.raises(RuntimeError, match="cannot sample the points"):
        mi.load_dict({"type": "ptracer"}).render(scene, spp=1)


@pytest.mark.parametrize("name", UNSAMPLED)
def test_unattenuated_lamp_refuses_shape_without_area(variant_rgb, tmp_path, name):
    scene = load_scene(lamp=shape_of(name, tmp_path) | {"emitter": {"type": "prosim_area", "unattenuated": True}})
    si = scene.ray_intersect(mi.Ray3f([0, 0, 5], [0, 0, -1]))
    with pytest.raises(RuntimeError, match="an unattenuated source needs a shape whose area Mitsuba knows"):
        scene.emitters()[0].eval(si)


@pytest.mark.slow
@pytest.mark.parametrize("case, integrator", [("tiled", DIRECT), ("none", PATHS)])
def test_scalar_variant_keeps_the_light_too(variant_scalar, tmp_path, case, integrator):
    shape, radiance = textured(case, tmp_path)
    scenes = [lit(shape | {"emitter": {"type": "area", "radiance": value}}) for value in (radiance, 3.0)]
    ours, expected = (mean(scene, integrator, spp=16, count=2)[0] for scene in scenes)
    assert ours == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("inner", [None, {"type": "path"}])
@pytest.mark.parametrize("degrees", [0, 3, 20, 45])
def test_lamp_with_tilted_normals_causes_warning(variant_rgb, tmp_path, logged, degrees, inner):
    angle = np.radians(degrees)
    normals = np.tile(np.array([np.sin(angle), 0, np.cos(angle)], np.float32), 4)
    scene = lit(write_square(tmp_path / "square.ply", normals=normals) | {"emitter": {"type": "prosim_area"}})
    integrator = {"type": "prosim_adaptive", "inner": inner} if inner else DIRECT
    mi.load_dict(integrator).render(scene, spp=1)
    said = [text for _, text in logged if "tilted" in text]
    assert [f"'lamp' (about {1 - np.cos(angle):.0%})" in text for text in said] == [True] * (degrees > 8)


def test_warnings_name_lamps_and_materials_without_an_id(variant_rgb, tmp_path, logged):
    """Few exporters write ids. A lamp is named by its file, and is not forgotten among others; a BSDF by its class."""
    write_square(tmp_path / "tilted.ply", normals=np.tile(np.array([1, 0, 1], np.float32) / 2**0.5, 4))
    write_square(tmp_path / "flat.ply")
    lamps = "".join(
        f"""<shape type="ply"><string name="filename" value="{tmp_path}/{name}.ply"/><emitter type="area"/>
        <transform name="to_world"><translate x="{x}"/></transform></shape>"""
        for name, x in (("flat", -9), ("tilted", 0), ("flat", 9))
    )
    cards = 2 * '<shape type="rectangle"><bsdf type="mask"><bsdf type="diffuse"/></bsdf></shape>'
    pixel = '<film type="hdrfilm"><integer name="width" value="1"/><integer name="height" value="1"/></film>'
    scene = mi.load_string(f'<scene version="3.0.0">{lamps}{cards}<sensor type="perspective">{pixel}</sensor></scene>')
    mi.load_dict({"type": "prosim_adaptive", "inner": {"type": "path"}}).render(scene, spp=1)
    said = [text.partition(" may ")[0] for _, text in logged]
    assert sorted(said) == ["prosim: 'MaskBSDF'", "prosim: 'tilted.ply' (about 29%)"]


def test_smooth_ball_of_triangles_causes_no_warning(variant_rgb, tmp_path, logged):
    """Eight triangles with the normals of a sphere."""
    ends = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 0), (0, -1, 0), (0, 0, -1)]
    rows = [("v", *v) for v in ends] + [("vn", *v) for v in ends]
    for x, y, z in np.ndindex(2, 2, 2):
        corners = (1 + 3 * x, 2 + 3 * y, 3 + 3 * z)
        rows.append(("f", *(f"{k}//{k}" for k in (corners if (x + y + z) % 2 == 0 else corners[::-1]))))
    (tmp_path / "ball.obj").write_text("\n".join(" ".join(map(str, row)) for row in rows))
    scene = lit({"type": "obj", "filename": str(tmp_path / "ball.obj"), "emitter": {"type": "prosim_area"}})
    mi.load_dict(DIRECT).render(scene, spp=1)
    assert not logged


@pytest.mark.parametrize("name", ["cylinder", *slow("sphere", "rectangle", "disk", "ply")])
def test_sampled_light_of_a_turned_lamp_is_that_of_rays(variant_rgb, tmp_path, name):
    """Rotated, or mirrored too, and perhaps flipped; with a number and with a bitmap; seen from outside and inside. A
    ray through a sampled point meets the same radiance, and the same normal.
    """
    turns = T().rotate([0, 0.6, 0.8], 150), T().rotate([0, 0.6, 0.8], 50).scale([1, -1, 1])
    texels = bitmap(np.random.default_rng(2).random((3, 3, 3)) + 0.5)
    u = mi.Point2f(np.random.default_rng(1).random((2, 64)).astype(np.float32))
    for to_world, flipped, (plugin, radiance) in itertools.product(turns, (False, True), zip(PLUGINS, (texels, 3.0))):
        emitter = {"type": plugin, "radiance": radiance}
        shape = shape_of(name, tmp_path) | {"to_world": to_world, "flip_normals": flipped, "emitter": emitter}
        scene = load_scene(lamp=shape)
        (lamp,) = scene.emitters()
        methods = EmitterMethods([lamp])
        ps = methods.sample_position(lamp, u, True)
        met = scene.ray_intersect(mi.Ray3f(ps.p + 0.05 * ps.n, -ps.n))
        assert dr.all(met.is_valid() & (dr.norm(met.p - ps.p) < 1e-3) & (dr.dot(met.sh_frame.n, ps.n) > 0.999))
        for place in [5, 4, 3], [0.05, 0.03, 0.02]:
            it = dr.zeros(mi.Interaction3f, 64)
            it.p = mi.Point3f(place)
            ds, weight = methods.sample_direction(lamp, it, u, True)
            met = scene.ray_intersect(mi.Ray3f(ds.p - 0.05 * ds.d, ds.d))
            grazes = dr.abs(dr.dot(ds.d, ds.n)) < 0.1
            assert dr.all(grazes | dr.all(dr.abs(lamp.eval(met) - weight * ds.pdf) < 0.02))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cylinder", "sphere", "rectangle", "disk"])
def test_light_of_a_turned_lamp_with_a_texture_comes_from_all_its_points(variant_rgb, tmp_path, name):
    """The solid angle times the radiance, by directions and by evenly distributed points: both differ by less than 6
    standard errors (significance below 1e-8), and less than 5 %. A thin cylinder, too.
    """
    turns = [T().rotate([1, 0, 0], x).rotate([0, 0, 1], z) for x, z in ((0, 0), (60, 40), (95, 0), (150, 10), (0, 120))]
    texels = bitmap(np.random.default_rng(2).random((3, 3, 3)) ** 4)
    u, v = (mi.Point2f(np.random.default_rng(seed).random((2, 1 << 19)).astype(np.float32)) for seed in (1, 3))
    for to_world, plugin, size in itertools.product(turns, PLUGINS, (1, 0.2) if name == "cylinder" else (1,)):
        shape = shape_of(name, tmp_path) | {"to_world": to_world.scale([size, size, 1])}
        scene = load_scene(lamp=shape | {"emitter": {"type": plugin, "radiance": texels}})
        (lamp,) = scene.emitters()
        methods, it = EmitterMethods([lamp]), dr.zeros(mi.Interaction3f)
        it.p = mi.Point3f(1.5, 3, 2)
        si = mi.SurfaceInteraction3f(methods.sample_position(lamp, v, True), it.wavelengths)
        towards, area = it.p - si.p, lamp.get_shape().surface_area()
        si = lamp.get_shape().ray_intersect(mi.Ray3f(si.p + 0.01 * si.n, -si.n))
        si.wi = si.to_local(dr.normalize(towards))
        even = lamp.eval(si) * dr.maximum(si.wi.z, 0) / dr.squared_norm(towards) * area
        samples = [np.array(values) for values in (methods.sample_direction(lamp, it, u, True)[1], even)]
        means, errors = np.mean(samples, axis=2), np.std(samples, axis=2) / 2**9.5
        difference, error = np.abs(means[0] - means[1]), np.hypot(*errors)
        assert np.all(difference <= 6 * error) and np.all(6 * error <= 0.05 * means[1]), (to_world, plugin, size)


@pytest.mark.slow
@pytest.mark.parametrize("plugin", PLUGINS)
@pytest.mark.parametrize("texture", [False, True])
def test_ball_that_shines_outwards_does_not_light_itself(variant_rgb, plugin, texture):
    """Through its own thin or glass surface: it looks as if it were black, to the bit."""
    radiance = bitmap(np.random.default_rng(2).random((3, 3, 3))) if texture else 2.0
    ball = {"type": "sphere", "center": [3, 1, 2], "emitter": {"type": plugin, "radiance": radiance}}
    sensor, images = camera([3, 1, 6], [3, 1, 2], film(8), fov=40), []
    for bsdf in diffuse(0, 0, 0), {"type": "principledthin", "diff_trans": 1.5, "spec_trans": 0.5}, ROUGH_GLASS:
        scene = load_scene(sensor=sensor, ball=ball | {"bsdf": bsdf})
        for settings in {"max_level": 0}, {"max_level": 1, "diffuse_bounces": -1}:
            made = mi.load_dict({"type": "prosim", "adaptive": "none", "samples": 4, **settings})
            images.append(np.array(made.render(scene)))
    assert images[0].max() > 0 and all(np.array_equal(image, images[0]) for image in images[1:])


def test_sky_with_compensation_is_sampled_as_a_whole(variant_rgb):
    """The irradiance by an ``envmap`` with ``mis_compensation`` is the mean over uniform directions: both differ by
    less than 6 standard errors (significance below 1e-8), and less than 2 %.
    """
    texels = mi.Bitmap(np.random.default_rng(3).random((8, 16, 3)).astype(np.float32) ** 3)
    plain = {"type": "envmap", "bitmap": texels}
    assert not EmitterMethods(load_scene(sky=plain).emitters()).partial
    sky = load_scene(sky=plain | {"mis_compensation": True}).emitters()[0]
    u = mi.Point2f(np.random.default_rng(1).random((2, 1 << 20)).astype(np.float32))
    methods, it = EmitterMethods([sky]), dr.zeros(mi.SurfaceInteraction3f)
    ds, weight = methods.sample_direction(sky, it, u, True)
    assert dr.allclose(methods.pdf_direction(sky, it, ds, True), ds.pdf)
    it.wi = mi.warp.square_to_uniform_hemisphere(u)
    uniform = sky.eval(it) * it.wi.z * dr.two_pi
    samples = [np.array(dr.mean(values, axis=0)) for values in (weight * dr.maximum(-ds.d.z, 0), uniform)]
    means, errors = np.mean(samples, axis=1), np.std(samples, axis=1) / 1024
    assert abs(means[0] - means[1]) < 6 * np.hypot(*errors) < 0.02 * means[1]


@pytest.mark.parametrize("inner", [None, {"type": "path"}])
@pytest.mark.parametrize("kind", ["envmap", "sunsky"])
def test_scaled_sky_causes_warning(variant_rgb, logged, kind, inner):
    integrator = mi.load_dict({"type": "prosim_adaptive", "inner": inner} if inner else DIRECT)
    mirrored = T().rotate([0, 0.6, 0.8], 50).scale([-1, 1, 1])
    for to_world, warnings in (mirrored, 0), (T().scale(2), 1), (T().rotate([1, 1, 0], 50), 2):
        sky = {"type": kind, "to_world": to_world}
        if kind == "envmap":
            sky["bitmap"] = mi.Bitmap(np.ones((4, 8, 3), np.float32))
        integrator.render(load_scene(sensor=camera([0, 3, 5], [0, 0, 0], film(1)), sky=sky), spp=1)
        assert sum("'sky'" in text and "to_world" in text for _, text in logged) == len(logged) == warnings


@pytest.mark.slow
@pytest.mark.parametrize("elsewhere, lamps", [(True, 1), (False, 6)])
def test_other_shapes_of_the_process_do_not_matter(variant_rgb, tmp_path, elsewhere, lamps):
    """A call for an array of shapes or emitters reaches all of the process; a glossy floor asks for their densities."""
    ball = {"type": "sphere", "radius": 0.5, "bsdf": {"type": "conductor"}}
    things = {"group": {"type": "shapegroup", "ball": ball}}
    of = {"type": "ref", "id": "group"}
    things["instance"] = {"type": "instance", "to_world": T().translate([0, -9, 0]), "of": of}
    for name, emitter in [*((name, {}) for name in UNSAMPLED), ("sdfgrid", area()), ("bsplinecurve", area())]:
        things[f"{name} {bool(emitter)}"] = {**shape_of(name, tmp_path), "bsdf": {"type": "conductor"}, **emitter}
    other = load_scene(**things) if elsewhere else None
    panel = {"type": "rectangle", "emitter": {"type": "prosim_area", "radiance": 3.0}}
    more = {f"lamp {k}": panel | {"to_world": T().translate([k, 4, 0]).rotate([1, 0, 0], 90)} for k in range(1, lamps)}
    glossy = {"type": "roughconductor", "alpha": 0.3}
    scene = lit(panel, glossy, ball=ball, **more, **({} if elsewhere else things))
    settings = {"max_level": 2} if lamps == 1 else {"max_level": 2, "diffuse_bounces": 2}
    integrator = mi.load_dict({"type": "prosim", "samples": 1, "caustics": True, "caustic_photons": 2000, **settings})
    assert np.array(integrator.render(scene)).mean() > 0.01
    del other


@pytest.mark.parametrize("shape, bounces", [("rectangle", 0), ("rectangle", -1), ("ply", 0)])
def test_lamps_in_one_plane_give_finite_light(variant_rgb, tmp_path, logged, shape, bounces):
    """A rotation rounds their normals, so that one sees the other at an angle whose cosine is as small as 1e-18, and
    with a density whose square is infinite. So does a wall that a lamp is flush with.
    """
    square = write_square(tmp_path / "square.ply") if shape == "ply" else {"type": shape}
    square |= area(40.0) | {"bsdf": {"type": "roughconductor", "alpha": 0.3}}
    side = {k: T().translate([2 * k, 0, 1]).rotate([1, 0, 0], 90).scale(0.5) for k in (-1, 1)}
    lamps = {f"lamp{k}": square | {"to_world": side[k]} for k in side}
    view = camera([2, -2, 1], [2, 0, 1], film(16), [1, 0, 0], fov=20)
    integrator = mi.load_dict({"type": "prosim", "diffuse_bounces": bounces, "max_level": 2})
    image = mi.render(load_scene(sensor=view, **lamps), integrator=integrator, spp=64, seed=1)
    assert not logged and np.min(image) >= 40 * (1 - 1e-5)
