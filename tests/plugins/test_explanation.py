"""The explanation of a pixel: its sums, against the image; its occluders, against rays of the tests."""

import json
from dataclasses import asdict

import drjit as dr
import mitsuba as mi
import mitsuba_prosim
import numpy as np
import pytest
from mitsuba_prosim.explaining import explanation_page, recorder
from mitsuba_prosim.explaining.explanation import Samples, places
from mitsuba_prosim.scene.scene_file import SceneFile
from scenes import COPPER, T, area, bitmap, diffuse, penumbra, rectangle, rgb, slow, sphere_lamp, without

SIZE, SPP, SEED = 16, 8, 5
GLASS = {"type": "roughdielectric", "alpha": 0.1}
HOLES = {"type": "mask", "opacity": bitmap([[[0.2], [0.9]], [[0.6], [0.3]]]), "bsdf": COPPER}
BLEND = {"type": "blendbsdf", "weight": 0.4, "a": COPPER, "b": diffuse(0.2, 0.5, 0.8)}
ABSORBING = {"type": "homogeneous", "albedo": 0.0, "sigma_t": rgb(1.0, 0.3, 0.75)}
PATHS = {"diffuse_bounces": -1, "rr_depth": 2}
BLACK_SKY = {"ambient": 0.1, "background": rgb(0.1, 0.2, 0.3), "hide_emitters": True}


def point(position, intensity):
    return {"type": "point", "position": position, "intensity": intensity}


#: name -> (material of the ball, parameters of the integrator, further things).
CASES = {
    "tree": (GLASS, BLACK_SKY, {}),
    "paths": (GLASS, PATHS, {}),
    "bounces": ({"type": "principled", "roughness": 0.3, "metallic": 0.5}, {"diffuse_bounces": 2}, {}),
    "sky": (COPPER, {}, {"sky": {"type": "constant", "radiance": 0.2}}),
    "layers": (GLASS, {"layers": "lights", "diffuse_bounces": 1}, {}),
    "masks": (HOLES, {"rr_throughput": 0.5}, {}),
    "blends": (BLEND, PATHS, {}),
    "absorption": ({"type": "dielectric"}, {}, {"interior": ABSORBING}),
    "caustics": ({"type": "dielectric"}, {"caustics": True, "caustic_photons": 5000}, {}),
    "lamps": (COPPER, {}, {f"lamp_{k}": point((k - 2.5, 3.5, -1.0), rgb(2, 3, 4)) for k in range(5)}),
}


def scene_of(name, rfilter="box", **more):
    ball, settings, things = CASES[name]
    integrator = {"type": "prosim", "adaptive": "none", "max_level": 3, **settings, **more}
    made = penumbra(ball, SIZE, rfilter, **integrator)
    made["ball"] |= {"interior": things["interior"]} if "interior" in things else {}
    panel = rectangle(T().look_at([0, 3, 3], [0, 0, 0], [0, 0, 1]).scale(0.5), **area(9.0))
    return mi.load_dict(made | {"panel": panel} | without(things, "interior"))


def pixels(count, seed=0):
    return [tuple(map(int, pixel)) for pixel in np.random.default_rng(seed).integers(0, SIZE, (count, 2))]


def parts(node):
    """All contributions of a node."""
    met = [node.emission.contribution] if node.emission else []
    return [node.ambient, node.background, node.photons, *(lamp.contribution for lamp in node.lamps), *met]


def check_sums(scene, *where):
    """The image has the mean of the samples, and each sample the contributions of its nodes and of their parts."""
    image = np.array(mi.render(scene, spp=SPP, seed=SEED))[..., :3]
    lit = 0
    for x, y in where or pixels(2):
        samples = Samples(scene, (x, y), SPP, seed=SEED)
        assert samples.values.mean(axis=0) == pytest.approx(image[y, x], rel=1e-5, abs=1e-7)
        for i, value in enumerate(samples.values):
            nodes = samples.recorder.nodes(i)
            assert np.sum([node.contribution for node in nodes], axis=0) == pytest.approx(value, rel=1e-5, abs=1e-6)
            for node in nodes:
                assert np.sum(parts(node), axis=0) == pytest.approx(node.contribution, rel=1e-6, abs=1e-9)
                assert node.parent in {0, *(other.number for other in nodes)} and 0 < node.survival <= 1 + 1e-5
            lit += value.any()
    assert lit


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_contributions_sum_to_samples_and_samples_to_the_image(variant_rgb, name):
    check_sums(scene_of(name))


@pytest.mark.slow
@pytest.mark.parametrize("settings", [{}, {"caustics": True, "caustic_photons": 5000}, PATHS])
def test_contributions_sum_with_dispersion_in_spectra(variant_spectral, settings):
    ball = {"type": "prosim_dielectric", "int_material": "sf10"}
    check_sums(mi.load_dict(penumbra(ball, SIZE, type="prosim", adaptive="none", **settings)))


@pytest.mark.slow
def test_contributions_sum_in_a_crop_window(variant_rgb):
    made = penumbra(GLASS, SIZE, type="prosim", adaptive="none")
    whole = mi.load_dict(made)
    made["sensor"]["film"] |= {"crop_offset_x": 5, "crop_offset_y": 3, "crop_width": 6, "crop_height": 4}
    here, there = (mitsuba_prosim.explain(s, p) for s, p in ((mi.load_dict(made), (2, 3)), (whole, (7, 6))))
    assert here.values == there.values and here.nodes == there.nodes


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["radiancemeter", "distant"])
def test_contributions_sum_for_a_meter_whose_rays_are_one(variant_rgb, kind):
    made = penumbra(GLASS, 1, type="prosim", adaptive="none")
    meter = {"type": kind, "to_world": made["sensor"]["to_world"], "film": made["sensor"]["film"]}
    check_sums(mi.load_dict(made | {"sensor": meter}), (0, 0))


@pytest.mark.slow
def test_lamp_samples_have_the_factors_of_their_contributions(variant_rgb):
    """Throughput times BSDF value times MIS weight times radiance over density."""
    checked = 0
    for pixel in pixels(2):
        for node in mitsuba_prosim.explain(scene_of("blends"), pixel, spp=SPP).nodes:
            for lamp in node.lamps:
                scattered = np.sum([np.multiply(lobe.bsdf, lobe.weight) for lobe in lamp.lobes], axis=0)
                product = np.prod([node.throughput, scattered, lamp.weighted_radiance], axis=0)
                expected = product if lamp.state == "visible" else np.zeros(3)
                assert lamp.contribution == pytest.approx(expected, rel=1e-4, abs=1e-7)
                checked += 1
    assert checked


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tree", "lamps", "paths"])
def test_occluders_are_what_rays_meet(variant_rgb, name):
    scene = scene_of(name)
    told = (mitsuba_prosim.explain(scene, pixel, spp=SPP) for pixel in pixels(4 if name == "tree" else 12, 1))
    nodes = [node for one in told for node in one.nodes]
    lit = [(node, lamp) for node in nodes for lamp in node.lamps if lamp.state in ("visible", "hidden")]
    origin, target = (mi.Point3f(np.transpose(p)) for p in zip(*((node.position, lamp.point) for node, lamp in lit)))
    distance, d = dr.norm(target - origin), dr.normalize(target - origin)
    si = scene.ray_intersect(mi.Ray3f(origin + 1e-3 * d, d))
    blocked = np.array(si.is_valid() & (si.t < distance * (1 - 1e-3) - 2e-3))
    assert blocked.tolist() == [lamp.state == "hidden" for _, lamp in lit] and len({*blocked.tolist()}) == 2
    names = {int(np.ravel(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(s)))[0]): s.id() for s in scene.shapes()}
    met = np.array(dr.reinterpret_array(mi.UInt32, si.shape))
    assert [names[k] for k in met[blocked]] == [lamp.occluder for _, lamp in lit if lamp.state == "hidden"]


def test_shape_within_an_instance_has_its_name(variant_rgb):
    made = without(penumbra(None, SIZE, type="prosim"), "ball", "pole")
    box = {"type": "cube", "to_world": T().translate([-1, 1.8, 1]).scale(0.6)}
    made |= {"group": {"type": "shapegroup", "box": box}}
    scene = mi.load_dict(made | {"one": {"type": "instance", "group": {"type": "ref", "id": "group"}}})
    nodes = [mitsuba_prosim.explain(scene, pixel, spp=SPP).nodes[0] for pixel in ((8, 4), (8, 9), (1, 4))]
    assert "box" in {node.shape for node in nodes}
    assert {lamp.occluder for node in nodes for lamp in node.lamps} == {None, "box"}


@pytest.mark.slow
def test_nodes_tell_shapes_lobes_and_densities(variant_rgb):
    """The tree of a smooth glass ball: reflected and refracted rays, of an ideal lobe and its probability."""
    scene = mi.load_dict(penumbra({"type": "dielectric"}, SIZE, type="prosim", max_level=2))
    first, *others = mitsuba_prosim.explain(scene, (9, 7)).nodes
    assert (first.number, first.lobe, first.shape) == (1, "camera", "ball")
    assert {"ideal reflection", "ideal transmission"} <= {node.lobe for node in others}
    for node in others:
        (parent,) = [one for one in (first, *others) if one.number == node.parent]
        assert node.number // 2 == node.parent and node.level == parent.level + 1
        assert node.density is None and 0 < node.probability <= 1
        assert np.allclose(node.origin, parent.position, atol=1e-2)


@pytest.mark.slow
def test_explanation_chooses_the_brightest_sample_and_is_json(variant_rgb):
    scene = scene_of("tree")
    told = mitsuba_prosim.explain(scene, (8, 8), spp=SPP, seed=SEED)
    assert told.sample == int(np.argmax(np.sum(told.values, axis=1))) and len(told.values) == SPP
    assert told.channels == ("R", "G", "B") and not told.notes
    assert json.loads(json.dumps(asdict(told)))["nodes"][0]["number"] == 1
    assert all(f'"{key}"' in told._repr_html_().replace("&quot;", '"') for key in ("patterns", "lobes", "boxes"))
    assert mitsuba_prosim.explain(scene, (8, 8), sample=3, spp=SPP, seed=SEED).nodes != told.nodes
    assert len(mitsuba_prosim.explain(scene, (8, 8), spp=0).values) == 25


def with_lamps(count):
    made = penumbra(COPPER, SIZE, type="prosim", max_level=1)
    places = np.random.default_rng(2).uniform([-3, 3, -3], [3, 4, 3], (count, 3)).tolist()
    return mi.load_dict(made | {f"lamp_{k}": point(place, rgb(0.2, 0.3, 0.4)) for k, place in enumerate(places)})


@pytest.mark.slow
def test_kernels_do_not_depend_on_the_number_of_lamps(variant_rgb):
    """Nor does the page grow with it: it sums up the dimmest lamps."""
    launches = []
    for count in (6, 100):
        scene = with_lamps(count)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            samples = Samples(scene, (8, 8), SPP)
            launches.append(len([one for one in dr.kernel_history() if one["type"] == dr.KernelType.JIT]))
    assert launches[0] == launches[1]
    node = samples.explanation().nodes[0]
    shown = explanation_page.shown(node)
    assert len(node.lamps) == 101 and shown["left"] == 101 - explanation_page.MOST_LAMPS == 101 - len(shown["lamps"])
    kept = np.sum([lamp["contribution"] for lamp in shown["lamps"]], axis=0)
    assert kept + shown["others"] == pytest.approx(np.sum([lamp.contribution for lamp in node.lamps], axis=0))


@pytest.mark.slow
def test_tables_grow_for_many_rays(variant_rgb, monkeypatch):
    scene = scene_of("tree")
    expected = mitsuba_prosim.explain(scene, (9, 8), spp=SPP)
    monkeypatch.setattr(recorder, "CAPACITY", 3)
    assert mitsuba_prosim.explain(scene, (9, 8), spp=SPP).nodes == expected.nodes and len(expected.nodes) > 3


def test_lines_are_those_of_the_scene_file(variant_rgb, write_scene, tmp_path):
    path = write_scene(
        "LIGHTS AREA position 0 5 5 intensity 65535 65535 65535 radius 1\n"
        "VIEW RESOLUTION 8 8 WINDOW -1 -1 1 1 EYE 0 0 9\n"
        "SOLID duo + SPHERE 3 SPHERE 1\nCSG-TREE +\n SPHERE 0 duo 2\nSURFACE 0 kd .5 .5 .5\nSURFACE 2 kd 0 .5 .5\n"
        "TRANSFORM 0\nTRANSFORM 3\nTRANSFORM 1 TRANSLATE (.5 0 0)\nTRANSFORM 2 TRANSLATE (0 9 0)\nEND\n"
    )
    (node, *_) = mitsuba_prosim.explain(path, (4, 4), spp=4).nodes
    assert (node.shape, node.line) == ("SPHERE 0 (line 5)", "s.scn, line 6 (SURFACE 0 of SPHERE 0)")
    assert node.lamps[0].lamp == "AREA (line 1)"
    # The primitives of a solid have the name and the line of its use.
    file = SceneFile(path, tmp_path)
    file.load()
    assert ("duo 2 (line 5)", "s.scn, line 7 (SURFACE 2 of duo 2)") in places(file).values()
    square = '<shape type="rectangle"><ref id="white"/><transform name="to_world"><translate {}/></transform></shape>\n'
    parts = ['<bsdf type="diffuse" id="white"/>\n', square.format('x="1"'), square.format('x="2"')]
    text = f'<scene version="3.0.0">\n{"".join(parts)}<shape type="sphere" id="ball"/></scene>'
    file = SceneFile(write_scene(text, "s.xml"), tmp_path)  # Mitsuba merges the two squares
    words = {key: name for key, (name, _) in places(file).items()}
    names = {name[:4]: name for name in recorder.shape_names(file.load(), words).values()}
    assert names["ball"] == "ball (line 5)" and names["Mesh"].endswith(" of white (line 2)")


def test_meshes_without_ids_are_named_by_their_files(variant_rgb, tmp_path):
    mi.load_dict({"type": "cube"}).write_ply(str(tmp_path / "box.ply"))
    mesh = {"type": "ply", "filename": str(tmp_path / "box.ply")}
    assert recorder.name_of(mi.load_dict(mesh), 7) == "box.ply"
    assert recorder.name_of(mi.load_dict({"type": "sphere"}), 7) == "Sphere 7"
    white = {"type": "ref", "id": "white"}
    parts = {kind: {"type": kind, "bsdf": white} for kind in ("rectangle", "cube")}  # Mitsuba merges them
    scene = mi.load_dict({"type": "scene", "white": {"type": "diffuse"}, **parts})
    assert list(recorder.shape_names(scene, {}).values()) == ["cube, ..."]


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind, nested, note",
    [
        ("path", "", "The integrator PathIntegrator keeps no record"),
        ("volpath", "", "except light that media scatter"),
        ("moment", "path", "The integrator PathIntegrator keeps no record"),
        ("prosim_adaptive", "path", "paths of prosim"),
        ("prosim_denoised", "prosim", "The image is denoised; these are the samples before."),
        ("prosim_adaptive", "prosim", "other random numbers"),
    ],
)
def test_other_integrators_are_explained_by_samples_of_prosim_and_say_so(variant_rgb, kind, nested, note):
    more = {"nested": {"type": nested}} if nested else {}
    told = mitsuba_prosim.explain(mi.load_dict(penumbra(GLASS, SIZE, type=kind, **more)), (8, 8), spp=SPP)
    (said,) = told.notes
    assert note in said and np.sum(told.mean) > 0


@pytest.mark.slow
def test_other_filters_and_colours_are_noted(variant_rgb):
    made = penumbra(GLASS, SIZE, "gaussian", type="prosim")
    made["sensor"]["film"]["pixel_format"] = "luminance"
    notes = mitsuba_prosim.explain(mi.load_dict(made), (8, 8), spp=SPP).notes
    assert [("filter" in note, "pixel_format" in note) for note in notes] == [(True, False), (False, True)]


@pytest.mark.parametrize(
    "kind, arguments, message",
    [
        ("prosim", {"pixel": (16, 0)}, "the pixel 16,0 is outside the image, whose pixels are 0,0 to 15,15"),
        ("prosim", {"pixel": (0, -1)}, "outside"),
        ("prosim", {"sample": 8}, "the sample 8 does not exist"),
        ("prosim", {"pixel": (0.5, 0)}, "the pixel 0.5,0 is outside"),
        ("prosim", {"pixel": "1,2"}, "pixel is '1,2'; give its column and row"),
        ("prosim", {"pixel": None}, "pixel is None; give"),
        ("prosim", {"sample": -1}, "sample is -1; allowed: a whole number from 0"),
        ("prosim", {"spp": -1}, "spp is -1"),
        ("prosim", {"spp": 2.5}, "spp is 2.5"),
        ("prosim", {"seed": "1"}, "seed is '1'"),
        ("prosim", {"sensor": None}, "sensor index is out of bounds"),
        ("ptracer", {}, "ParticleTracerIntegrator"),
        ("depth", {}, "DepthIntegrator"),
        ("moment", {}, "MomentIntegrator"),
    ],
)
def test_explanation_refuses_wrong_arguments(variant_rgb, kind, arguments, message):
    with pytest.raises(ValueError, match=message):
        mitsuba_prosim.explain(mi.load_dict(penumbra(None, SIZE, type=kind)), **{"pixel": (0, 0), "spp": 8} | arguments)


def test_explanation_refuses_integrators_of_users(variant_rgb):
    """Also those with a depth, such as the radiance field of Mitsuba's tutorials, whose light is another."""

    class Field(mi.ad.integrators.common.RBIntegrator):
        pass

    with pytest.raises(ValueError, match="the integrator Field has no samples"):
        mitsuba_prosim.explain(mi.load_dict(penumbra(None, SIZE)), (0, 0), integrator=Field(mi.Properties()))


def test_explanation_refuses_scalar_variants(variant_scalar):
    with pytest.raises(RuntimeError, match="scalar"):
        mitsuba_prosim.explain(mi.load_dict(penumbra(None, SIZE)), (0, 0))


@pytest.mark.slow
def test_explanation_leaves_the_image_as_it_was(variant_rgb):
    scene = scene_of("lamps")
    before = np.array(mi.render(scene, spp=4))
    mitsuba_prosim.explain(scene, (8, 8), spp=4)
    assert np.array_equal(before, np.array(mi.render(scene, spp=4))) and dr.flag(dr.JitFlag.SymbolicLoops)


def test_sample_that_is_not_finite_counts_as_black_and_says_so(variant_rgb):
    made = without(penumbra(None, SIZE, type="prosim"), "light")
    made["ball"] |= {"emitter": {"type": "area", "radiance": 3e38}, "bsdf": diffuse(1, 1, 1)}
    made |= {"lamp": point([0.5, 0.9, 1.0], 3e38)}
    samples = Samples(mi.load_dict(made), (8, 7), 4)
    black, *_ = np.flatnonzero(samples.values.sum(axis=1) == 0)
    told = samples.explanation(int(black))
    assert any(told.nodes[0].contribution) and "black" in told.notes[0] and "Infinity" not in json.dumps(asdict(told))


def shares_at(made, pixel):
    """The shares of the dimensions in the variance of a pixel, and the sentences."""
    told = mitsuba_prosim.explain(mi.load_dict(made), pixel, spp=16)
    return told.shares, " ".join(told.noise)


def sunny():
    """Paths of one reflection under a directional light."""
    made = without(penumbra({"type": "diffuse"}, 512, type="prosim", diffuse_bounces=1), "light")
    return made | {"sun": {"type": "directional", "direction": [0, -1, -0.2], "irradiance": 1.0}}


def blurred():
    """A floor and a ball that are out of focus."""
    made = without(penumbra(None, 512, type="prosim", background=1.0), "light", "wall", "pole")
    made["sensor"] |= {"type": "thinlens", "aperture_radius": 0.3, "focus_distance": 1.0}
    return made


def glass_under_a_point_light(**settings):
    """A smooth glass ball, whose rays have a single direction, and whose lamp has a single point."""
    made = penumbra({"type": "dielectric"}, 64, type="prosim", **settings)
    return made | {"light": point([-1, 4, 2], 30.0)}


#: Dimension -> (a scene, a pixel) whose noise it carries alone.
ALONE = {
    "pixel": (lambda: without(penumbra(None, SIZE, type="prosim", background=1.0), "light", "wall"), (11, 5)),
    "lamp": (lambda: penumbra(None, 512, type="prosim"), (441, 251)),
    "lobe": (sunny, (280, 462)),
    "lens": (blurred, (196, 92)),
    "roulette": (lambda: glass_under_a_point_light(rr_throughput=0.9), (32, 34)),
    "photons": (lambda: glass_under_a_point_light(caustics=True, caustic_photons=20000), (26, 4)),
}


@pytest.mark.parametrize("name", ["pixel", "lamp", *slow("lobe", "lens", "roulette", "photons")])
def test_dimension_that_carries_the_noise_alone_has_a_share_of_1(variant_rgb, name):
    """Of 8192 pairs, the standard error of the share is at most 0.04; the bounds are four of them away."""
    make, pixel = ALONE[name]
    shares, said = shares_at(make(), pixel)
    assert shares[name] == pytest.approx(1, abs=0.4) and max(shares, key=shares.get) == name
    assert sum(shares.values()) - shares[name] < 0.3 and f"{shares[name]:.0%}" in said


@pytest.mark.parametrize("background", [{"background": 1.0}, {}], ids=["background", "nothing"])
def test_equal_samples_have_no_noise(variant_rgb, background):
    made = without(penumbra(None, SIZE, type="prosim", **background), "light", "wall", "floor", "ball", "pole")
    assert shares_at(made, (1, 1)) == ({}, "All samples are equal, so the pixel has no noise.")


def test_outliers_name_lamp_and_surface(variant_rgb):
    """Two lamps and ambient light; the noise is that of the shadow of one lamp."""
    made = penumbra(None, 512, type="prosim", ambient=5.0)
    made["far"] = point([0, 9, 9], 9.0)
    _, said = shares_at(made, ALONE["lamp"][1])
    assert "the light of light by way of wall" in said and "What would help: more samples." in said


@pytest.mark.slow
def test_noise_of_rays_that_meet_lamps_through_holes_asks_for_photons(variant_rgb):
    """The holes hide the lamp from its own samples; the light does not come from the sheet with the holes."""
    made = without(penumbra(None, 16, type="prosim", diffuse_bounces=-1, max_level=2), "ball", "pole", "light")
    made["sheet"] = rectangle(T().translate([0, 3, 0]).rotate([1, 0, 0], 90).scale(6), bsdf=HOLES)
    made["panel"] = rectangle(T().translate([0, 4, 0]).rotate([1, 0, 0], 90).scale(0.3), **area(9.0))
    told = mitsuba_prosim.explain(mi.load_dict(made), (8, 14), spp=64)
    assert "the light of panel by way of sheet" in told.light[0]
    assert told.noise[-1] == "What would help: more samples, and photons (caustics)."


@pytest.mark.slow
def test_noise_names_samples_that_are_brighter_than_those_explained(variant_rgb):
    """Of eight explanations by one sample each, some see the lamp and others do not."""
    scene = mi.load_dict(penumbra(None, 512, type="prosim"))
    taken = [Samples(scene, ALONE["lamp"][1], 1, seed=seed) for seed in range(8)]
    told = [" ".join(samples.explanation().noise) for samples in taken]
    dark = [not samples.values.any() for samples in taken]
    assert ["much brighter than any sample here" in said for said in told] == dark and 0 < sum(dark) < 8
    assert not [said for said in told if "differs most" in said]  # a single sample is the mean


def test_sentences_tell_where_light_comes_from_and_what_hides_it(variant_rgb):
    told = mitsuba_prosim.explain(mi.load_dict(penumbra(None, 512, type="prosim")), ALONE["lamp"][1], spp=16)
    first, second = told.light
    assert first == "Where the light comes from: the light of light by way of wall (100%)."
    assert second.startswith("Seen from wall at level 0: of 16 points of light, ")
    assert second.endswith(" hidden by ball.")
    assert 0 < int(second.split()[-4]) < 16


def bulb(**more):
    return point([0, 3, 0], 9.0) | more


def spot():
    return {"type": "spot", "to_world": T().translate([0, 3, 0]).rotate([0, 1, 0], 90)}


CONE = {"type": "prosim_point", "distribution": "cone", "angle": 20, "direction": [1, 0, 0]}
GREY = diffuse(0.5, 0.5, 0.5)
BACK = GREY, "on its back", "plate"
#: Name -> (makes the lamp, the floor's material, state of the lamp's points, what is in their way).
DARK = {
    "cone": (spot, GREY, "outside its cone", None),
    "prosim_cone": (lambda: bulb(**CONE), GREY, "outside its cone", "plate"),
    "back": (lambda: rectangle(T().translate([0, 3, 0]).rotate([1, 0, 0], -90), **area()), *BACK),
    "below": (lambda: bulb(position=[0, -1, 0]), GREY, "below the surface", None),
    "ball_below": (lambda: sphere_lamp([0, -2, 0], 0.5, 9.0), GREY, "below the surface", None),
    "black": (bulb, diffuse(0, 0, 0), "not scattered", None),
    "off": (lambda: bulb(intensity=0.0), GREY, "not lit", None),
    "hidden": (bulb, GREY, "hidden", "plate"),
    "glass": (bulb, GREY, "hidden", "plate"),
    "visible": (bulb, GREY, "visible", None),
    "through": (lambda: bulb(position=[0, -1, 0]), GLASS | {"alpha": 0.6}, "visible", None),
}


@pytest.mark.parametrize("name", DARK)
def test_points_of_lamps_that_add_no_light_say_why(variant_rgb, name):
    lamp, bsdf, state, occluder = DARK[name]
    plate = rectangle(
        T().translate([0, 2, 0]).rotate([1, 0, 0], -90).scale(3),
        bsdf=GLASS if name == "glass" else diffuse(0.3, 0.4, 0.5),
    )
    made = without(penumbra(None, SIZE, type="prosim", max_level=0), "wall", "pole", "ball", "light")
    made |= {"floor": made["floor"] | {"bsdf": bsdf}, "lamp": lamp()} | ({"plate": plate} if occluder else {})
    made["sensor"] |= {"to_world": T().look_at([0.1, 1.5, 1], [0, 0, 0], [0, 1, 0])}
    told = mitsuba_prosim.explain(mi.load_dict(made), (8, 8), spp=4)
    assert [(one.state, one.occluder) for one in told.nodes[0].lamps] == [(state, occluder)]
    words = f"hidden by {occluder}" if state == "hidden" else state
    said = f"Seen from floor at level 0: of 4 points of lamp, 4 {words}."
    missing = "Light of lamps through plate is missing, because only caustics find it."
    assert told.light[1:] == (said,) * (state != "visible") + (missing,) * (name == "glass")


class Asked:
    """The points of a sample, which keep the spaces that the transport asks for."""

    def __init__(self, points, spaces):
        self.points, self.spaces = points, spaces

    def __call__(self, space, active=True):
        self.spaces.update(np.ravel(space).tolist())
        return self.points(space, active)

    def __getattr__(self, name):
        return getattr(self.points, name)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paths", "lamps", "sky", "bounces", "masks"])
def test_patterns_are_the_random_numbers_that_the_samples_use(variant_rgb, name, monkeypatch):
    """Each pass of an N-rook pattern has one sample in each row and column, and all passes one in each cell."""
    n, (x, y), scene = 4, (9, 8), scene_of(name, samples=4)
    samples = Samples(scene, (x, y), 0)
    trees = [samples.recorder.nodes(i) for i in range(n * n)]
    found = explanation_page.patterns(samples.estimator, samples.plan, samples.where, n * n, trees)
    for _, _, numbers in found:
        cells = np.reshape(numbers, (n, n, 2)) * n // 1000
        assert (np.sort(cells, axis=1) == np.arange(n)[:, None]).all()
        assert len({*map(tuple, cells.reshape(-1, 2))}) == 16
    pixel = next(np.reshape(numbers, (-1, 2)) for number, label, numbers in found if (number, label) == (1, "pixel"))
    for nodes, place in zip(trees, (pixel + 0.5) / 1000):
        ray, _ = scene.sensors()[0].sample_ray(0, 0.5, np.add(place, (x, y)) / SIZE, [0.5, 0.5])
        assert np.ravel(ray.d) == pytest.approx(nodes[0].direction, abs=1e-4)
    asked, points, transport = set(), type(samples.plan).points, samples.estimator.transport
    monkeypatch.setattr(type(samples.plan), "points", lambda *where: Asked(points(*where), asked))
    with dr.scoped_set_flag(dr.JitFlag.SymbolicLoops, False):
        samples.estimator.sample(samples.plan, *(mi.Int32(value) for value in (x, y)), dr.arange(mi.UInt32, n * n))
    shown = {transport.space(k, s) for nodes in trees for k, s, _ in explanation_page.node_spaces(transport, nodes)}
    assert shown <= asked and len(shown) == len(found) - 1 > 0
