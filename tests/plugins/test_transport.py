"""Surfaces of every kind in the tree and along paths: BSDFs within BSDFs, such as have no separate lobes, the ambient
term. Beer's law along what a ray goes through: against its formula, and against Mitsuba's ``volpath``.
"""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from image_statistics import cards, renderings, same_expectation
from mitsuba_prosim.compare.methods import with_background_emitter
from mitsuba_prosim.compat import to_world_name
from mitsuba_prosim.transport import lobes, workarounds
from mitsuba_prosim.transport.absorption import absorbs_any, media_of
from mitsuba_prosim.transport.scattering import Scattering
from scenes import (
    FLAT,
    T,
    area,
    bitmap,
    camera,
    diffuse,
    film,
    load_scene,
    rectangle,
    rgb,
    slow,
    sphere_lamp,
    without,
    write_square,
)

BLACK = {"type": "diffuse", "reflectance": 0.0}
PRINCIPLED = {"type": "principled", "base_color": 0.5, "roughness": 0.4}
LAMBERTIAN = {"type": "prosim_lambertian", "reflectance": 0.5}
MIRROR = {"type": "conductor"}
PATH = {"type": "path"}
ROUGH = {"type": "roughconductor", "alpha": 0.3}
MATT = {"type": "diffuse", "reflectance": 0.8}
GLASS = {"type": "roughdielectric", "alpha": 0.4, "int_ior": 1.8}
THIN = {"type": "principledthin", "diff_trans": 1.0, "spec_trans": 0.5, "roughness": 0.5, "eta": 1.4}
#: Pairs of which one lets light through, and the samples of one are often discarded.
GLASSES = (GLASS, ROUGH), (GLASS, {"type": "prosim_dielectric", "alpha": 0.3}), (GLASS, {"type": "dielectric"})
OTHERS = (THIN, MATT), ({"type": "hair", "eumelanin": 0.2}, MATT)

bounces = pytest.mark.parametrize("bounces", [0, 3, -1], ids=["tree", "paths by two rays", "paths"])


def card(bsdf, **others):
    """A card before the camera; a rough metal ball out of sight lets the scene have every kind of lobe."""
    return {
        "type": "scene",
        "sensor": camera([0, 0, 5], [0, 0, 0], film(8), fov=20),
        "card": {"type": "rectangle", "to_world": T().scale(3), "bsdf": bsdf},
        "ball": {"type": "sphere", "center": [90, 0, 0], "bsdf": {"type": "roughconductor"}},
        **others,
    }


def test_an_instance_looks_as_what_it_is_of(variant_scalar):
    """Also where the lobes cannot be told apart, of which the instance itself says nothing: none is counted thrice."""
    scene = card(PRINCIPLED, light=sphere_lamp([1.5, 1.5, 3], 0.3, 10.0), integrator={"type": "prosim"})
    instance = {"type": "instance", "shapegroup": {"type": "ref", "id": "group"}}
    of_it = without(scene, "card") | {"group": {"type": "shapegroup", "card": scene["card"]}, "card": instance}
    images = [np.array(mi.render(mi.load_dict(description), spp=4)) for description in (scene, of_it)]
    assert images[1].mean() == pytest.approx(images[0].mean(), rel=0.05)


def of_a_group(bsdf, ids=("", ""), sky='<emitter type="constant"/>'):
    """A ball and a card in an instance; ``ids``: their attributes in XML."""
    ball, card = (f'<shape type="{kind}" {name}>{{}}</shape>' for kind, name in zip(("sphere", "rectangle"), ids))
    card = card.format('<transform name="to_world"><translate x="1.5"/></transform>')
    group = f'<shape type="shapegroup" id="g">{ball.format(f"""<bsdf type="{bsdf}"/>""")}{card}</shape>'
    return mi.load_string(f"""<scene version="3.0.0"><integrator type="prosim"><integer name="max_level" value="3"/>
        </integrator>{group}<shape type="instance"><ref id="g"/></shape>{sky}<sensor type="perspective">
        <transform name="to_world"><lookat origin="0, 0, 6" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film></sensor>
        </scene>""")


@pytest.mark.parametrize("bsdf", ["conductor", "dielectric", "principled"])
def test_shapes_of_a_group_need_no_ids(variant_rgb, bsdf):
    """The light of a tree's mirror, glass and so on was missing if another shape of the group had no id, either."""
    images = [mi.render(of_a_group(bsdf, ids), spp=4, seed=1) for ids in (("", ""), ('id="ball"', 'id="card"'))]
    assert np.array_equal(*images)


def test_background_lights_instances_for_other_integrators(variant_rgb):
    black = of_a_group("conductor", sky="")
    lit, path = with_background_emitter(black, mi.load_dict(rgb(1, 1, 1))), mi.load_dict(PATH)
    image = np.array(mi.render(lit, sensor=black.sensors()[0], integrator=path, spp=4, seed=1))
    assert np.allclose(image, mi.render(of_a_group("conductor"), integrator=path, spp=4, seed=1)) and image.any()
    with pytest.raises(ValueError, match="Checkerboard can't light the scene"):
        with_background_emitter(black, mi.load_dict({"type": "checkerboard"}))


@pytest.mark.parametrize("sensor", ["perspective", "prosim_window", *slow("thinlens", "orthographic")])
@pytest.mark.parametrize("hidden", [False, True])
def test_nothing_is_seen_beyond_far_clip(variant_rgb, sensor, hidden):
    """A wall at 5 is not seen with the far plane at 3, but at 7; nor behind a hidden lamp."""
    lens = {"aperture_radius": 0.01, "focus_distance": 5.0} if sensor == "thinlens" else {}
    lamp = {"lamp": rectangle(T().translate([0, 0, 4]), **area())} if hidden else {}

    def image(far):
        seen_by = camera([0, 0, 5], [0, 0, 0], film(4), near_clip=0.1, far_clip=far, **lens) | {"type": sensor}
        scene = load_scene(
            integrator={"type": "prosim", "ambient": 1.0, "max_level": 0, "hide_emitters": hidden},
            sensor=seen_by,
            wall=rectangle(T().scale(9), bsdf=LAMBERTIAN),
            **lamp,
        )
        return np.array(mi.render(scene, spp=4))

    assert np.all(image(3.0) == 0) and np.allclose(image(7.0), 0.5, atol=1e-5)


@pytest.mark.parametrize("more", [{"caustics": True}, {"diffuse_bounces": -1}])
def test_a_mesh_with_normals_of_length_zero_is_black(variant_rgb, tmp_path, logged, more):
    """As in ``path``. Its shading frames are NaN, which spread to all paths that met it."""
    board = write_square(tmp_path / "board.ply", normals=np.zeros(12, np.float32)) | {"to_world": T().scale(3)}
    wall = rectangle(T().translate([0, 0, -1]).scale(9))
    mirror = {"type": "sphere", "center": [3, 0, 1], "bsdf": {"type": "conductor"}}
    view = camera([0, 0, 9], [0, 0, 0], film(8), fov=60)
    lamps = {f"lamp{x}": sphere_lamp([x, 2, 3], 0.3, 9.0) for x in (1, 2)}
    scene = load_scene(sensor=view, **lamps, board=board, wall=wall, mirror=mirror)
    integrator = mi.load_dict({"type": "prosim", "max_level": 2, **more})
    image = np.array(mi.render(scene, integrator=integrator, spp=16))
    assert not logged and image[4, 4].max() == 0 < image[0, 0].min()


@pytest.mark.parametrize("light", [{}, {"light": {"type": "prosim_point"}}], ids=["no light", "a point"])
@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "scalar_rgb"])
def test_a_scene_without_surfaces_shows_its_background(monkeypatch, variant, light):
    """In the tree and along paths; Dr.Jit has nothing to dispatch to, unless the process holds another scene."""
    mi.set_variant(variant)
    monkeypatch.setattr("drjit.dispatch", lambda *args: pytest.fail("asks for a BSDF where there is none"))
    ours = {"type": "prosim", "ambient": rgb(1.0, 1.0, 1.0), "background": rgb(0.25, 0.5, 0.75)}
    empty = without(card(BLACK, **light), "card", "ball")
    for integrator in (ours, ours | {"max_level": -1, "diffuse_bounces": -1}, {"type": "prosim_adaptive", "of": ours}):
        image = np.array(mi.render(mi.load_dict(empty | {"integrator": integrator}), spp=4))[..., :3]
        assert np.allclose(image, [0.25, 0.5, 0.75], atol=1e-6)


# ------------------------------------------------------------------ mask and blendbsdf, whose lobes need care


def masked(bsdf, opacity=0.6):
    return {"type": "mask", "opacity": opacity, "b": bsdf}


def blended(a, b, weight=0.5):
    return {"type": "blendbsdf", "weight": weight, "a": a, "b": b}


def two_sided(bsdf):
    return {"type": "twosided", "b": bsdf}


def behind_black(bsdf):
    return {"type": "twosided", "a": BLACK, "b": bsdf}


def in_bumps(bsdf):
    return {"type": "bumpmap", "texture": bitmap(FLAT), "b": bsdf}


def row_of_cards(bsdfs, lamps, turn=0, **integrator):
    """The means of :func:`cards` and their standard errors, of shape (cards, 4)."""
    values = cards(bsdfs, 8, lamps, turn, spp=100, **integrator)
    return values.mean(1), values.std(1, ddof=1) / 8


@bounces
def test_ideal_lobes_under_an_even_sky(variant_rgb, bounces):
    """A perfect mirror, and what lies behind, are as bright as the sky. A blend loses what its black half takes.

    Each of twelve differences, where there is noise at all, is below 4 standard errors (p < 1e-3 together).
    """
    black = ROUGH | {"specular_reflectance": 0.0}
    bsdfs = masked(MIRROR), masked(masked(MIRROR), 0.7), blended(MIRROR, BLACK), blended(black, MIRROR, 0.6)
    ours = {"type": "prosim", "adaptive": "none", "diffuse_bounces": bounces}
    mean, error = (v[:, 0] for v in row_of_cards(bsdfs, {"sky": {"type": "constant"}}, **ours))
    assert (error < 0.01).all()
    assert (np.abs(mean - [1, 1, 0.5, 0.6]) < 4 * error + 1e-5).all(), (mean, error)


@pytest.mark.slow
@pytest.mark.parametrize("bounces, pairs", [(0, GLASSES), (-1, GLASSES), (-1, OTHERS)])
def test_a_blend_with_glass_is_the_mean_of_both_from_behind(variant_rgb, bounces, pairs):
    """Mitsuba takes samples that one BSDF discards for samples of the other, and gains light.

    Each of five differences is below 4 standard errors (p < 4e-4 together).
    """
    bsdfs = [bsdf for pair in pairs for bsdf in (*pair, blended(*pair))]
    ours = {"type": "prosim", "adaptive": "none", "diffuse_bounces": bounces}
    mean, error = (v[:, 0] for v in row_of_cards(bsdfs, {"sky": {"type": "constant"}}, turn=120, **ours))
    expected = (mean[::3] + mean[1::3]) / 2
    errors = np.hypot(error[2::3], np.hypot(error[::3], error[1::3]) / 2)
    assert (np.abs(mean[2::3] - expected) < 4 * errors).all(), (mean[2::3], expected, errors)


@pytest.mark.parametrize("other", [BLACK, *slow(PRINCIPLED)], ids=["apart", "whole"])
@pytest.mark.parametrize(
    "wrap, z, through",
    [(lambda b: masked(b, 0.3), 0.8, 0.7), (two_sided, 0.8, 0), (two_sided, -0.8, 0), (behind_black, -0.8, 0)],
    ids=["mask", "front", "back", "back alone"],
)
def test_the_derivative_by_a_share_is_that_of_ideal_lobes_too(variant_rgb, other, wrap, z, through):
    """A mirror has a share w in a blend of the weight w, from either side, and what passes straight through none of
    it.
    """
    bsdf = mi.load_dict(wrap(blended(other, MIRROR | {"specular_reflectance": 0.5}, 0.4)))
    params = mi.traverse(bsdf)
    (key,) = (key for key, _ in params if key.endswith("weight.value"))
    dr.enable_grad(params[key])
    params.update()
    n = 10_000
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.wi = mi.Vector3f(0.6, 0, z)
    choice = (dr.arange(mi.Float, n) + 0.5) / n
    bs, weight = workarounds.sample(mi.BSDFContext(), bsdf, si, (choice, mi.Point2f(0.3, 0.6)), mi.Bool(True))
    ideal = lobes.has_any(bs.sampled_type, *lobes.IDEAL) & (bs.pdf > 0)
    brought = dr.mean(dr.select(ideal, weight.x, 0))
    assert brought[0] == pytest.approx(through + 0.5 * (1 - through) * 0.4, abs=2e-3)
    mirrored = lobes.has_any(bs.sampled_type, "DeltaReflection") & (bs.pdf > 0)
    assert dr.all(~mirrored | (dr.norm(bs.wo - mi.Vector3f(-0.6, 0, z)) < 1e-5))
    dr.backward(brought)
    assert dr.grad(params[key])[0] == pytest.approx(0.5 * (1 - through), rel=5e-3)


@pytest.mark.parametrize("bounces", [0, -1], ids=["tree", "paths"])
def test_a_blend_of_a_mirror_in_a_map(variant_rgb, bounces):
    """Differences within 4 standard errors (p < 2e-4 together)."""
    blends = blended(in_bumps(PRINCIPLED), in_bumps(MIRROR), 0.4), masked(blended(PRINCIPLED, MIRROR, 0.4), 0.5)
    ours = {"type": "prosim", "adaptive": "none", "diffuse_bounces": bounces}
    mean, error = (v[:, 0] for v in row_of_cards((PRINCIPLED, *blends), {"sky": {"type": "constant"}}, **ours))
    expected = mean[0] * np.array([1, 0.6, 0.3]) + [0, 0.4, 0.7]
    assert (np.abs(mean - expected) < 4 * np.hypot(error, error[0]) + 1e-5).all(), (mean, expected, error)


@pytest.mark.slow
@pytest.mark.parametrize(
    "bsdf, needed",
    [
        (masked(MATT, 0.5), False),
        (masked(two_sided(ROUGH), 0.5), False),
        (masked(blended(MATT, ROUGH), 0.5), False),
        (in_bumps(blended(MATT, ROUGH)), False),
        (masked(PRINCIPLED, 0.5), False),
        (blended(MATT, MIRROR), True),
        (blended(MATT, masked(ROUGH, 0.5)), True),
        (blended(two_sided(MATT), two_sided(ROUGH)), False),
        (blended(MATT, two_sided(ROUGH)), True),
        (blended(GLASS, MATT), True),
    ],
)
def test_paths_have_workarounds_only_where_they_need_them(variant_rgb, monkeypatch, bsdf, needed):
    """The images have the same bits, because Mitsuba samples all lobes together rightly."""
    scene = mi.load_dict(card(bsdf, light=sphere_lamp([1.5, 1.5, 3], 0.3, 10.0), sky={"type": "constant"}))
    paths = mi.load_dict({"type": "prosim", "adaptive": "none", "diffuse_bounces": -1})
    image = np.array(mi.render(scene, integrator=paths, spp=16))
    assert Scattering(scene, separate=False, whole=True).needs_workarounds == needed
    monkeypatch.setattr(workarounds, "mixes_wrongly", lambda *_: True)
    monkeypatch.setattr(workarounds, "_sample_mixture", lambda ctx, one, si, u, lit, _: one.sample(ctx, si, *u, lit))
    again = np.array(mi.render(scene, integrator=paths, spp=16))
    assert needed or (np.array_equal(image, again) and image.any())


@pytest.mark.parametrize(
    "bsdf, lobe, warned",
    [
        (in_bumps(two_sided(blended(ROUGH, MIRROR))), lobes.SPECULAR, True),
        (in_bumps(blended(PRINCIPLED, MIRROR)), lobes.SPECULAR, True),
        (masked(in_bumps(blended(MATT, MIRROR))), lobes.SPECULAR + lobes.DIFFUSE, True),
        (in_bumps(blended(GLASS, ROUGH)), lobes.SPECULAR, True),
        (in_bumps(blended(MATT, MIRROR)), lobes.SPECULAR, False),
        (blended(in_bumps(MATT), in_bumps(MIRROR)), lobes.SPECULAR + lobes.DIFFUSE, False),
    ],
)
def test_a_map_around_a_blend_of_a_mirror_is_warned_of(variant_rgb, logged, bsdf, lobe, warned):
    workarounds.warn_of_blends_in_maps(load_scene(ball={"type": "sphere", "bsdf": bsdf}), lobes.only(lobe))
    assert any("Put the map into the blendbsdf" in text for _, text in logged) == warned


@pytest.mark.slow
def test_blend_in_a_closed_box_is_no_noisier_than_by_path(variant_rgb):
    """The mean variance of 576 pixels, from 6 images each, is at most four times that by ``path``, though each wall is
    met many times. With these seeds the ratio is 0.02 to 2.4; the standard error of its logarithm is about 0.1.
    """
    plastic = {"type": "plastic", "diffuse_reflectance": 0.8}
    scene = {
        "type": "scene",
        "sensor": camera([0, 0, 0.9], [0, 0, 0], film(24, component_format="float32"), fov=70),
        "box": {"type": "cube", "flip_normals": True, "bsdf": blended(plastic, ROUGH)},
        "lamp": sphere_lamp([0.3, 0.5, 0], 0.2, 5.0) | {"bsdf": BLACK},
    }

    def variance(**integrator):
        return renderings(scene, 6, spp=64, **integrator).var(0, ddof=1).mean()

    expected = variance(type="path")
    assert variance(type="prosim", adaptive="none", max_level=8) < 4 * expected
    assert variance(type="prosim", adaptive="none", max_level=-1, diffuse_bounces=-1) < 4 * expected


# ------------------------------------------------------------------ what absorbs


#: Absorption by unit of length, as the tests have it.
SIGMA = np.array([1.0, 2.0, 0.5])

#: Glass that is seen by what it absorbs alone, and glass.
UNSEEN, GLASS = ({"type": "prosim_dielectric", "int_ior": n, "ext_ior": 1.0} for n in (1.0, 1.5))


def medium(*sigma, **more):
    return {"type": "homogeneous", "albedo": 5e-7, "sigma_t": rgb(*(s / 10 for s in sigma)), "scale": 10.0, **more}


def reference(name):
    return {"type": "ref", "id": name}


def looking(at, **things):
    """A ray along -z through (``at``, 0), towards a lamp of radiance 1 behind all else."""
    place = T().look_at([at, 0, 9], [at, 0, 0], [0, 1, 0]).scale(1e-5)
    return {
        "type": "scene",
        "integrator": {"type": "prosim", "adaptive": "none", "max_level": 6},
        "sensor": {"type": "orthographic", "to_world": place, "film": film(1)},
        "lamp": rectangle(T().translate([0, 0, -9]).scale(20), **area()),
        **things,
    }


def slab(bsdf, **others):
    return {"type": "cube", "to_world": T().scale([4, 4, 0.5]), "bsdf": bsdf, "interior": medium(*SIGMA), **others}


def ball(bsdf):
    return {"type": "sphere", "bsdf": bsdf, "interior": medium(*SIGMA)}


def seen(scene, spp=4, **integrator):
    scene["integrator"] = scene["integrator"] | integrator
    return np.array(mi.render(mi.load_dict(scene), spp=spp))[0, 0, :3]


def between_two_faces(t):
    """What goes through two faces of index 1.5 at normal incidence, and whatever is reflected between them: ``t`` is
    the transmittance from one to the other.
    """
    r = 0.04
    return (1 - r) ** 2 * t / (1 - r * r * t * t)


@pytest.mark.parametrize("variant_name", ["llvm_ad_rgb", "scalar_rgb"])
@pytest.mark.parametrize("bounces", [0, -1])
def test_beers_law_in_a_slab_and_a_ball(variant_name, bounces):
    mi.set_variant(variant_name)
    mode = {"diffuse_bounces": bounces}
    assert seen(looking(0.0, it=slab(UNSEEN)), **mode) == pytest.approx(np.exp(-SIGMA), abs=1e-5)
    assert seen(looking(0.6, it=ball(UNSEEN)), **mode) == pytest.approx(np.exp(-1.6 * SIGMA), abs=5e-5)
    if bounces == 0:  # paths take one of the two ways at a face
        assert seen(looking(0.0, it=slab(GLASS))) == pytest.approx(between_two_faces(np.exp(-SIGMA)), abs=1e-5)
        assert seen(looking(0.0, it=ball(GLASS))) == pytest.approx(between_two_faces(np.exp(-2 * SIGMA)), abs=1e-5)


def test_the_length_is_exact_far_from_the_origin(variant_rgb):
    """Rays begin at some distance from the surface that they leave, which grows with its coordinates."""
    thin = slab(UNSEEN, to_world=T().translate([0, 0, -800]).scale([4, 4, 0.5]))
    scene = looking(0.0, it=thin)
    scene["lamp"]["to_world"] = T().translate([0, 0, -900]).scale(20)
    assert seen(scene) == pytest.approx(np.exp(-SIGMA), rel=1e-4)


@pytest.mark.parametrize("told", [True, False])
def test_a_sensor_within_a_medium(variant_rgb, told):
    """The sensor's medium counts, and without one what the first surface says of its inside."""
    scene = looking(0.0, inside=medium(*SIGMA, id="inside"), it=slab(UNSEEN, interior=reference("inside")))
    scene["sensor"]["to_world"] = T().look_at([0, 0, 0.25], [0, 0, 0], [0, 1, 0]).scale(1e-5)
    scene["sensor"]["near_clip"] = 1e-4
    if told:
        scene["sensor"]["medium"] = reference("inside")
    assert seen(scene) == pytest.approx(np.exp(-0.75 * SIGMA), rel=2e-4)
    if told:  # also where no shape has a medium
        assert seen(without(scene, "it")) == pytest.approx(np.exp(-9.25 * SIGMA), rel=1e-3)


def test_light_within_a_medium_is_absorbed_on_its_way_to_what_it_lights(variant_rgb):
    """A point lamp in a ball lights a card there: the shadow ray goes through the medium, and so does the camera's."""
    card = rectangle(T().translate([0, 0, -0.5]).scale(0.2), bsdf=diffuse(0.5, 0.5, 0.5))
    point = {"type": "point", "position": [0, 0.3, 0.0], "intensity": 1.0}
    scene = looking(0.0, it=slab(UNSEEN, to_world=T().scale(1)), card=card, point=point)
    d = np.hypot(0.3, 0.5)
    expected = 0.5 / np.pi * (0.5 / d) / d**2 * np.exp(-SIGMA * (d + 1.5))
    assert seen(without(scene, "lamp")) == pytest.approx(expected, rel=1e-3)


def test_media_of_instances(variant_rgb):
    copy = {"type": "instance", "to_world": T().translate([0, 0, 1]), "group": reference("group")}
    scene = looking(0.0, group={"type": "shapegroup", "it": slab(UNSEEN)}, copy=copy)
    assert len(list(media_of(mi.load_dict(scene)))) == 1
    assert seen(scene) == pytest.approx(np.exp(-SIGMA), abs=1e-5)


def test_a_scattering_medium_is_ignored_with_a_warning(variant_rgb, logged):
    """One beside a medium that absorbs, which counts."""
    fog = medium(*SIGMA, id="fog") | {"albedo": rgb(0.0, 0.0, 0.4)}
    behind = slab(UNSEEN, to_world=T().translate([0, 0, -3]).scale([4, 4, 0.5]), interior=fog)
    assert seen(looking(0.0, behind=behind)) == pytest.approx(1)
    ((_, text),) = logged
    assert "fog" in text and "albedo" in text
    assert not absorbs_any(mi.load_dict(looking(0.0, behind=behind)), None)
    assert seen(looking(0.0, it=slab(UNSEEN), behind=behind)) == pytest.approx(np.exp(-SIGMA), abs=1e-5)


@pytest.mark.parametrize("sky", ["constant", "envmap", "directional"])
@pytest.mark.parametrize("ours", [{}, {"diffuse_bounces": -1}, {"caustics": True}, {"nested": {"type": "path"}}])
def test_closed_room_of_merged_rectangles_is_dark(variant_rgb, sky, ours):
    """Mitsuba's box of this scene has only the ball, and its lamps at infinity are just outside of the box."""
    image = {"bitmap": mi.Bitmap(np.ones((4, 4, 3), np.float32))} if sky == "envmap" else {}
    turns = [(axis, sign) for axis in ([1, 0, 0], [0, 1, 0]) for sign in (90, -90)] + [([1, 0, 0], s) for s in (0, 180)]
    walls = [T().rotate(axis, angle).translate([0, 0, -5]).scale(5) for axis, angle in turns]
    wall = {"type": "ref", "id": "wall"}
    room = {f"wall{k}": rectangle(to_world, bsdf=wall) for k, to_world in enumerate(walls)}
    things = {"wall": {"type": "twosided", "b": diffuse(0.5, 0.5, 0.5)}, **room, "sky": {"type": sky, **image}}
    ball = {"type": "sphere", "radius": 0.5, "bsdf": {"type": "dielectric"} if "caustics" in ours else diffuse(1, 1, 1)}
    integrator = {"type": "prosim_adaptive" if "nested" in ours else "prosim", **ours}
    world = load_scene(**things, ball=ball, sensor=camera([0, 0, 4], [0, 0, 0], film(8)), integrator=integrator)
    assert len(world.shapes()) == 2 and not np.any(mi.render(world, spp=4))
    assert np.allclose(world.bbox().max, 5)


def test_merged_meshes_keep_their_normals(variant, tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvn 0 1 1\nvn 1 0 1\nvn 0 0 1\nf 1/1/1 2/2/2 3/3/3\n"
    (tmp_path / "bent.obj").write_text(text)
    bsdf = {"type": "ref", "id": "paint"}
    mesh = {"type": "obj", "filename": str(tmp_path / "bent.obj"), "bsdf": bsdf}
    square = rectangle(T().translate([3, 0, 0]), bsdf=bsdf)
    world = load_scene(paint=diffuse(0.5, 0.5, 0.5), mesh=mesh, square=square)
    (merged,) = world.shapes()
    before = np.array(mi.traverse(merged)["vertex_normals"])
    workarounds.repair_boxes(world)
    assert np.array_equal(mi.traverse(merged)["vertex_normals"], before) and np.allclose(world.bbox().max, [4, 1, 0])


@pytest.mark.parametrize("place, size, warned", [(0, 1, ""), (1e4, 1e3, ""), (0, 1e-3, "0.002"), (-5e5, 10, "20")])
@pytest.mark.parametrize("ours", [{"type": "prosim"}, {"type": "prosim_adaptive", "nested": {"type": "path"}}])
def test_scene_that_is_tiny_or_far_away_causes_a_warning(variant, logged, ours, place, size, warned):
    """Where Mitsuba's rays start, 9e-5 times (1 + the greatest coordinate) above a surface, they miss corners."""
    pixel = camera([place, 0, 5 * size], [place, 0, 0], film(1))
    shape = {"type": "sphere", "center": [place, 0, 0], "radius": size}
    mi.render(load_scene(sensor=pixel, integrator=ours, shape=shape, lamp={"type": "constant"}), spp=1)
    assert [f"the scene is {warned} wide" in text for _, text in logged] == [True] * bool(warned)


@pytest.mark.slow
@pytest.mark.parametrize("bounces, lamp, warned", [(-1, "point", True), (-1, "sphere", False), (0, "sphere", True)])
@pytest.mark.parametrize("surface", ["null", "dielectric"])
def test_medium_that_stops_the_light_of_a_lamp_causes_a_warning(variant, logged, bounces, lamp, warned, surface):
    """Not a surface of glass, where ``volpath`` stops shadow rays, too."""
    lamp = {"type": "point"} if lamp == "point" else sphere_lamp([0, 0, 9], 0.3, 1.0)
    ours = {"type": "prosim", "diffuse_bounces": bounces}
    box = {"type": "cube", "bsdf": {"type": surface}, "interior": medium(*SIGMA)}
    pixel = camera([0, 0, 5], [0, 0, 0], film(1))
    mi.render(load_scene(sensor=pixel, integrator=ours, box=box, lamp=lamp), spp=1)
    assert ["end at 'box'" in text for _, text in logged] == [True] * (warned and surface == "null")


@pytest.mark.slow
def test_derivatives_by_absorption_and_thickness(variant_rgb):
    """exp(-s t) has the derivatives -t exp(-s t) and -s exp(-s t)."""
    scene = looking(0.0, it=ball(UNSEEN))
    scene["integrator"] |= {"diffuse_bounces": -1, "max_level": 2}
    scene = mi.load_dict(scene)
    params = mi.traverse(scene)
    sigma, to_world = "it.interior_medium.sigma_t.value.value", to_world_name(params, "it.")
    before = mi.Color3f(params[sigma])
    left = np.exp(-2 * SIGMA)

    grown, sigmas = mi.Float(0), mi.Color3f(before)
    dr.enable_grad(grown, sigmas)
    params[sigma], params[to_world] = sigmas, mi.Transform4f().scale(1 + grown)
    params.update()
    dr.backward(dr.sum(mi.render(scene, params, spp=4), axis=None))
    assert np.ravel(dr.grad(sigmas)) == pytest.approx(-20 * left, abs=1e-3)
    assert dr.grad(grown)[0] == pytest.approx(np.sum(-2 * SIGMA * left), abs=1e-3)


def test_the_features_of_a_denoiser_are_tinted(variant_rgb):
    scene = looking(0.0, it=slab(UNSEEN), integrator={"type": "prosim_features"})
    assert seen(scene) == pytest.approx(np.exp(-SIGMA), rel=1e-3)


@pytest.mark.slow
def test_same_expectation_as_volpath(variant_rgb):
    """Nested media, a lamp and a dull ball within, rough glass beside them: as ``volpath`` renders them."""
    air, green = {"type": "dielectric", "int_ior": 1.0, "ext_ior": 1.5}, reference("green")
    bubble = {"bsdf": air, "interior": medium(2, 0.1, 0.1), "exterior": green}
    rough = {"bsdf": {"type": "roughdielectric", "alpha": 0.2}, "interior": medium(0.1, 2, 2)}
    scene = {
        "type": "scene",
        "sensor": camera([0, 1, 6], [0, 0, 0], film(24), fov=28),
        "green": medium(0.9, 0.2, 1.2, id="green"),
        "outer": {"type": "sphere", "radius": 1.3, "bsdf": GLASS, "interior": green},
        "bubble": {"type": "sphere", "center": [-0.6, 0, 0.3], "radius": 0.4, **bubble},
        "dull": {"type": "sphere", "center": [0.5, -0.3, 0.2], "radius": 0.4, "bsdf": {"type": "diffuse"}},
        "lamp": sphere_lamp([0.2, 0.7, 0.4], 0.2, 3.0),
        "rough": {"type": "cube", "to_world": T().translate([1.6, -1, 0.2]).scale(0.5), **rough},
        "floor": rectangle(T().translate([0, 0, -2]).scale(6), bsdf={"type": "diffuse"}),
        "sky": {"type": "constant", "radiance": 0.7},
    }
    volpath = renderings(scene, 8, spp=100, type="volpath", max_depth=12, rr_depth=100)
    mode = {"adaptive": "none", "diffuse_bounces": -1, "max_level": 10, "rr_depth": 100}
    assert same_expectation(volpath, renderings(scene, 8, spp=100, type="prosim", **mode))


# ------------------------------------------------------------------ what is opaque


SEEN_THROUGH = {
    "nothing": None,
    "diffuse": diffuse(0.2, 0.2, 0.2),
    "mask": masked(diffuse(0.2, 0.2, 0.2), 0.3),
    "mask of mask": masked(masked(MIRROR, 0.5)),
    "mask in a blend": blended(masked(BLACK, 0.5), LAMBERTIAN, 0.7),
    "twosided in a mask": masked(two_sided(LAMBERTIAN), 0.2),
    "thin glass": {"type": "thindielectric"},
    "glass": {"type": "dielectric"},
    "null": {"type": "null"},
}


def lights(kind):
    lamp = rectangle(T().translate([0, 0, -1]).scale(40), **area(3.0))
    sky = {"sky": {"type": "constant", "radiance": 0.5}}
    return {"none": {}, "sky": sky, "sky and lamp": sky | {"lamp": lamp}}[kind]


EVERY = (*SEEN_THROUGH,)


@pytest.mark.slow
@pytest.mark.parametrize(
    "variant, names, hidden, kind",
    [
        ("llvm_ad_rgb", EVERY, False, "sky"),
        ("llvm_ad_rgb", EVERY, True, "sky"),
        ("llvm_ad_rgb", EVERY, False, "none"),
        ("llvm_ad_rgb", EVERY, True, "sky and lamp"),
        ("llvm_ad_rgb", ("nothing",), True, "sky and lamp"),
        ("scalar_rgb", ("mask in a blend",), True, "sky and lamp"),
    ],
)
def test_alpha_and_hidden_emitters_as_by_volpath(variant, names, hidden, kind):
    """The means by the tree and by paths differ from those by ``volpath`` by less than 4.5 standard errors (72
    comparisons: p < 0.001 together), or by rounding.
    """
    mi.set_variant(variant)
    bsdfs = [SEEN_THROUGH[name] for name in names]
    expected, expected_error = row_of_cards(bsdfs, lights(kind), type="volpath", hide_emitters=hidden)
    for bounces in (0, -1):
        ours = {"type": "prosim", "adaptive": "none", "diffuse_bounces": bounces, "hide_emitters": hidden}
        found, error = row_of_cards(bsdfs, lights(kind), **ours)
        wrong = np.abs(found - expected) > 4.5 * np.hypot(expected_error, error) + 1e-3
        assert not wrong.any(), (bounces, [name for name, bad in zip(names, wrong.any(1)) if bad], found, expected)
