"""Caustics: photons that specular surfaces gather on diffuse ones, against paths and analytic irradiance."""

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import mitsuba_prosim  # noqa: F401  (registers the plugins)
import numpy as np
import pytest
from mitsuba_prosim.alone import alone
from mitsuba_prosim.engine.error_target import limit_by_photons
from mitsuba_prosim.light.strategy import Receiver
from mitsuba_prosim.photons import grid
from mitsuba_prosim.photons.caustics import Caustics, diffuse_radiance
from mitsuba_prosim.photons.emission import MARGIN, Sources, Targets, bounding_sphere, is_specular, merged, start_points
from mitsuba_prosim.photons.grid import RADII, Footprint, Landed, Photons
from mitsuba_prosim.photons.mis import Hit, ideal_throughput, ray_weight
from mitsuba_prosim.transport import lobes
from mitsuba_prosim.transport.ray import Vertex, viewer_side
from mitsuba_prosim.transport.scattering import Scattering
from scenes import FLAT, T, area, bitmap, camera, film, ground, in_threads, load_scene, rectangle, write_square


def view(size, origin=(0, 4, 6), target=(0, 0, 0), fov=35):
    return camera(origin, target, film(size, pixel_format="rgb"), fov=fov)


def parallel(size, half, origin, target, up=(0, 0, 1)):
    """A camera with parallel rays that sees ``half`` to each side of its target."""
    place = T().look_at(origin=origin, target=target, up=up).scale((half, half, 1))
    return mi.load_dict({"type": "orthographic", "to_world": place, "film": film(size, pixel_format="rgb")})


def floor(reflectance, kind="diffuse"):
    return ground(6, {"type": kind, "reflectance" if kind == "diffuse" else "base_color": reflectance})


def ball(bsdf, center=(0, 1.2, 0), radius=0.8):
    return {"type": "sphere", "center": center, "radius": radius, "bsdf": bsdf}


def lamp(radius=2.0, radiance=5.0, center=(-3, 5, 1)):
    return ball({"type": "diffuse", "reflectance": 0.0}, center, radius) | area(radiance)


def scene(size=24, reflectance=0.5, **things):
    return load_scene(**{"sensor": view(size), "floor": floor(reflectance)} | things)


def render(scene, seed=0, sensor=0, **parameters):
    defaults = {"type": "prosim", "samples": 4, "adaptive": "none", "max_level": 6, "caustics": True}
    integrator = mi.load_dict(defaults | {"caustic_photons": 1 << 15} | parameters)
    return np.array(mi.render(scene, sensor=sensor, integrator=integrator, seed=seed))


#: Glass that turns light into a rainbow.
DISPERSIVE = {"type": "prosim_dielectric", "int_material": "sf10"}


#: Metal that sees what is smooth.
ROUGH = {"type": "prosim_conductor", "material": "Cu", "alpha": 0.3}


def small(size=16, glass=None, **things):
    return scene(size, ball=ball(glass or {"type": "dielectric"}), lamp=lamp(), **things)


def on_metal(size=16):
    """The same with a plate of rough metal before the ball, which gathers photons too."""
    place = T().translate((0, 0.1, 1.4)).rotate((1, 0, 0), -90).scale((1.8, 0.9, 1))
    return small(size, plate=rectangle(place, bsdf=ROUGH))


# ---------------------------------------------------------------- what they are aimed at


def test_many_spheres_are_merged_into_few_around_all():
    spheres = np.random.default_rng(1).random((100, 4))
    few = np.array(merged(spheres.tolist(), 7))
    assert len(few) == 7
    gaps = few[:, 3] - spheres[:, None, 3] - np.linalg.norm(spheres[:, None, :3] - few[:, :3], axis=2)
    assert gaps.max(axis=1).min() > -1e-9
    assert np.allclose(sorted(map(tuple, merged(spheres[:5].tolist(), 7))), sorted(map(tuple, spheres[:5])))


# ---------------------------------------------------------------- what is found


@pytest.mark.slow
@pytest.mark.parametrize("enough, times", ((0, RADII[0]), (20, None)))
def test_all_photons_within_reach_are_found(variant_rgb, monkeypatch, enough, times):
    """Against a sum over all of them, on planes that lie aslant in the grids; so few buckets that many cells share one,
    and the last is next to the first. Where photons are sparse, their radius is greater.
    """
    monkeypatch.setattr(grid, "MIN_NEIGHBOURS", enough)
    rng, count, maps, size = np.random.default_rng(3), 1600, 100, 1024
    normals = np.array([(0, 1, 0), (1, 0, 0), (0, 0, 1), (1, 2, 3)], dtype=float)
    normal = np.repeat(normals / np.linalg.norm(normals, axis=1, keepdims=True), size // 4, axis=0)
    pixel = 0.05 if times else 0.2
    p, d, flux = (rng.normal(size=(count, 3)) * scale for scale in (0.25, 1, 1))
    flux = np.abs(flux)
    points, number = rng.normal(size=(size, 3)) * 0.2, rng.integers(maps, size=size)
    map_of = np.sort(rng.integers(maps, size=count))
    spread = pixel if times else 1e-9  # else rounding may change a radius
    footprint = Footprint(mi.Point3f(0.4, 3, 0.1), mi.Float(pixel), mi.Float(spread))
    place = mi.Point3f(*p.T)
    valid = dr.full(mi.Bool, True, count)
    landed = Landed(place, mi.Vector3f(*d.T), mi.Color3f(*flux.T), valid, mi.Float(0), mi.UInt32(0))
    photons = Photons(landed, mi.UInt32(map_of), maps, footprint)
    si = dr.zeros(mi.SurfaceInteraction3f, size)
    si.p, si.n = mi.Point3f(*points.T), mi.Normal3f(*normal.T)
    si.sh_frame, si.wi = mi.Frame3f(si.n), mi.Vector3f(0, 0, 1)
    white = mi.load_dict({"type": "diffuse", "reflectance": 1.0})
    world = load_scene(floor=floor(1.0), ball=ball(ROUGH))
    vertex = Vertex(si, white, mi.Bool(True), mi.Bool(False), mi.Bool(True), None, None)
    L = diffuse_radiance(Scattering(world), photons, mi.UInt32(number), vertex)
    width = footprint.width(place)
    radius = np.round(np.array(grid.kernel_radii(place, footprint) / width)).astype(int)
    assert set(radius) == {times} if times else len(set(radius)) > 1
    reach = (pixel + spread * np.linalg.norm(points - (0.4, 3, 0.1), axis=1))[:, None] * radius
    off = p - points[:, None]
    d2 = np.sum(off**2, axis=2) / reach**2
    near = (d2 < 1) & (np.abs(np.einsum("ijk,ik->ij", off, normal)) < 0.25 * reach)
    near &= (normal @ d.T < 0) & (number[:, None] == map_of)
    expected = (near * (1 - d2) * (2 / np.pi**2 / reach**2)) @ flux
    assert near.sum() > 100
    assert np.abs(np.array(L).T - expected).max() < 1e-4 * np.abs(expected).max()


def traced(world, count):
    """The caustics of a scene, and where ``count`` photons of its first lamp land."""
    caustics = Caustics.of(world, world.sensors()[0], 1, 1 << 31, True)
    i, caustics.sources.per_pair = dr.arange(mi.UInt32, count), mi.Float(count)
    start = caustics.sources.start(i * 0, *start_points(mi.UInt32(7), i), mi.Color0f())
    return caustics, caustics.tracer(start, i)[0]


def sun(kind, far):
    """A sun at the distance ``far``: a direction, a point or a ball."""
    place = [0.6 * far, 0.8 * far, 0]
    if kind == "directional":
        return {"type": kind, "direction": (-0.6, -0.8, 0)}
    return {"type": kind, "position": place, "intensity": far**2} if kind == "point" else lamp(far / 10, 30.0, place)


@pytest.mark.parametrize("kind", ("directional", "point", "sphere"))
def test_a_far_lamp_or_a_wide_ground_loses_no_light(variant_rgb, kind):
    """A glass ball focuses the light of a sun at a spot of the ground, as much as if all were near."""
    spots, widths = [], []
    for far in (1e3, 1e5):
        things = {"floor": rectangle(T().rotate((1, 0, 0), -90).scale(far)), "sun": sun(kind, far)}
        world = load_scene(sensor=view(4), ball=ball({"type": "dielectric"}), **things)
        caustics, landed = traced(world, 1 << 15)
        near = landed.valid & (dr.norm(landed.p - mi.Point3f(-0.7, 0, 0)) < 0.5)
        spots.append(dr.sum(dr.select(near, landed.flux.x, 0))[0])
        widths.append(caustics.footprint.width(mi.Point3f(0))[0])
    assert spots[1] == pytest.approx(spots[0], rel=0.01)
    assert widths[1] == pytest.approx(widths[0], rel=0.01)


def test_fewer_photons_than_pairs_of_lamp_and_glass_have_the_same_power(variant_rgb):
    """Each of the pairs had a photon in each map: 16 million with 4000 lamps and 64 balls."""
    lamps = {f"lamp{k}": lamp(0.2, 1.0 + k, (k - 3, 3, 1)) for k in range(6)}
    balls = {f"ball{k}": ball({"type": "dielectric"}, (k - 3, 0.8, -1), 0.4) for k in range(6)}
    world, powers = scene(4, **lamps, **balls), []
    for count, passes in ((1 << 16, 1), (64, 60)):
        caustics, power = Caustics.of(world, world.sensors()[0], count, 6, True), 0
        for number in range(passes):
            caustics.use_pass(1, number, 4)
            flux = vars(caustics)["_current"][0].landed.flux
            assert 0 < dr.width(flux) <= count
            power += dr.sum(flux.x)[0] / (16 * passes)
        powers.append(power)
    assert powers[1] == pytest.approx(powers[0], rel=0.1)  # some thousand photons of unequal power


# ---------------------------------------------------------------- the same bits


@pytest.mark.slow
def test_bands_crops_and_threads_do_not_change_a_bit(variant_rgb):
    assert_same_bits(on_metal())


@pytest.mark.slow
def test_bands_crops_and_threads_do_not_change_a_bit_in_spectral_variants(variant_spectral):
    assert_same_bits(small(glass=DISPERSIVE))


def assert_same_bits(world):
    whole = render(world, adaptive="neighbours")
    assert np.array_equal(render(world, adaptive="neighbours", band=37), whole)
    parameters = mi.traverse(world.sensors()[0])
    parameters["film.crop_offset"], parameters["film.crop_size"] = (3, 5), (9, 8)
    parameters.update()
    for threads in (1, 2):
        crop = in_threads(threads, render, world, adaptive="neighbours")
        assert np.array_equal(crop, whole[5:13, 3:12])


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["radiancemeter", "batch"])
def test_a_sensor_without_pixels_finds_a_caustic(variant_rgb, kind):
    """The light that a camera sees in its middle, where there is no other light."""
    near = view(4, target=(0.68, 0, -0.17), fov=1)
    more = {"film": film(4), "camera": near} if kind == "batch" else {"film": film(1), "to_world": near["to_world"]}
    world = small(sensor=near, meter={"type": kind, **more})
    expected, found = (render(world, sensor=k, samples=8, caustic_photons=1 << 17).mean() for k in (0, 1))
    assert found == pytest.approx(expected, rel=0.1) and expected > 0.1


def test_without_specular_surfaces_or_sources_nothing_changes_and_a_warning_says_so(variant_rgb, logged):
    dull = scene(ball=ball({"type": "diffuse"}), lamp=lamp())
    assert np.array_equal(render(dull), render(dull, caustics=False))
    dark = scene(ball=ball({"type": "dielectric"}))
    assert np.array_equal(render(dark), render(dark, caustics=False))
    said = [text.rpartition(": ")[2] for _, text in logged]
    assert said == ["no surface is a mirror, glass or glossy.", "no lamp can emit photons."]


def test_each_sample_has_photons_of_its_own(variant_rgb):
    world, found = small(), []
    x, y = np.random.default_rng(1).random((2, 2000), dtype=np.float32)
    si = world.ray_intersect(world.sensors()[0].sample_ray(0, 0.5, mi.Point2f(x, y), mi.Point2f(0.5))[0])
    met, caustics = si.is_valid(), Caustics.of(world, world.sensors()[0], 1 << 12, 7, True)
    vertex = Vertex(si, si.bsdf(), met, mi.Bool(False), met, None, None)
    for seed, number, t in (1, 0, 0), (1, 0, 1), (1, 1, 0), (2, 0, 0), (1, 0, 0):
        caustics.use_pass(seed, number, 2)
        found.append(np.array(caustics.add_to(mi.Spectrum(0), vertex, mi.UInt32(t))))
    assert [np.array_equal(one, found[0]) for one in found] == [True, *3 * [False], True] and found[0].max() > 0


def test_a_pass_takes_as_many_samples_as_most_pixels_request():
    """A few pixels that request more get no photons of their own."""

    def samples(requested, most=1 << 20):
        return limit_by_photons(np.full(len(requested), 25), np.array(requested), most, 25, 1 << 20)

    assert samples([50] * 900 + [100] * 90 + [5000] * 10) == 50
    assert samples([50] * 400 + [100] * 590 + [5000] * 10) == 100
    assert samples([25] * 990 + [5000] * 10) == 0  # no more than there is
    assert samples([25] * 990 + [5000] * 10, most=5000) == 5000  # nothing else is to come


@pytest.mark.slow
@pytest.mark.parametrize("more", ({"diffuse_bounces": -1}, {}))
def test_a_source_that_does_not_say_where_it_is_is_left_out_with_a_warning(variant_rgb, logged, more):
    """And leaves the light of the others."""
    beam = rectangle(T().translate((0, 9, 0)).scale(0.1), emitter={"type": "directionalarea"})
    alone, beside = (render(small(12, **things), **more) for things in ({}, {"beam": beam}))
    assert beside.mean() == pytest.approx(alone.mean(), rel=0.05)
    ((level, text),) = logged
    assert level == mi.LogLevel.Warn and "DeltaPosition" in text


# ---------------------------------------------------------------- what is refused


def test_refusals_say_what_to_do(variant_rgb):
    world = small(4)
    parameters = mi.traverse(world)
    dr.enable_grad(parameters["floor.bsdf.reflectance.value"])
    photons = {"type": "prosim", "samples": 1, "caustics": True, "caustic_photons": 64}
    image = mi.render(world, parameters, integrator=mi.load_dict(photons))
    with pytest.raises(RuntimeError, match="caustics have no derivatives; leave them out"):
        dr.backward(dr.sum(image, axis=None))
    around = mi.load_dict({"type": "aov", "aovs": "p:position", "nested": photons})
    with pytest.raises(RuntimeError) as refused:
        mi.render(small(4), integrator=around)
    assert "its own render() alone" in str(refused.value.__cause__)


def test_a_warning_names_materials_without_separate_lobes_that_cast_light_on_one_another(variant_rgb, logged):
    """In a tree this light is left out."""
    glass = {"type": "principled", "roughness": 0.3, "spec_trans": 1.0, "eta": 1.5}
    world = scene(4, thing=ball(glass), lamp=lamp(), floor=floor(0.5, "principled"))
    Caustics.of(small(4, glass), world.sensors()[0], 16, 3, tree=True)
    assert not logged
    Caustics.of(world, world.sensors()[0], 16, 3, tree=True)
    ((_, text),) = logged
    assert "'thing'" in text and "'floor'" in text and "diffuse_bounces" in text


# ---------------------------------------------------------------- shared with rays


def met_by_rays():
    """A source of each kind that rays can meet, around the middle."""
    values = np.arange(1, 13, dtype=np.float32).reshape(2, 2, 3)

    def facing(x, z):
        return {"to_world": T().look_at(origin=(x, 5, z), target=(0, 1, 0), up=(0, 1, 0))}

    beam = {"type": "prosim_area", "distribution": "cone", "angle": 40.0, "direction": (3, -4, 3)}
    return {
        "ball": lamp(0.3, center=(-5, 5, 0)),
        "cone": lamp(0.3, center=(-3, 5, -3)) | {"emitter": beam},
        "square": {"type": "rectangle"} | area(3.0) | facing(3, 3),
        "cube": {"type": "cube"} | area(3.0) | facing(5, 0),
        "window": {"type": "rectangle"} | area(bitmap(values)) | facing(0, 5),
        "screen": {"type": "rectangle", "emitter": {"type": "prosim_area", "radiance": bitmap(values)}} | facing(0, -5),
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(np.tile(values, (2, 2, 1)))},
    }


@pytest.mark.slow
def test_rays_know_how_many_photons_there_are_as_these_do_themselves(variant_rgb):
    """The same line, of a photon that starts and of a ray of the eye that ends in its source."""
    glass = {"type": "dielectric"}
    world = scene(4, near=ball(glass), far=ball(glass, (1, 0.3, 1), 0.3), **met_by_rays())
    sources, n = Sources(world, Targets([s for s in world.shapes() if is_specular(s, True)])), 128
    i = dr.arange(mi.UInt32, sources.pairs * n)
    sources.per_pair = mi.Float(n)
    start = sources.start(i // n, *start_points(mi.UInt32(5), i), mi.Color0f())
    own = dr.gather(mi.EmitterPtr, sources.pointers, i // (2 * n))
    origin = dr.zeros(mi.Interaction3f)
    origin.p = start.ray(dr.select(own.is_environment(), 0, 0.1))
    ds = mi.DirectionSample3f(world, world.ray_intersect(mi.Ray3f(origin.p, -start.ray.d)), origin)
    # Rounding is divided by the cosine at the source.
    met = (dr.max(start.flux) > 0) & (ds.emitter == own) & (own.is_environment() | (dr.dot(ds.n, start.ray.d) > 0.6))
    expected, found, met = (np.array(v) for v in (start.density, sources.density(origin, ds, met), met))
    assert np.all(met.reshape(-1, 2 * n).sum(axis=1) > n / 8)
    assert np.mean(np.abs(found[met] / expected[met] - 1) < 5e-3) > 0.99  # some lines graze what they are aimed at
    assert not found[~met].any()
    # In the middle between both balls: the one behind gets no photons from there.
    (a, b), radius, targets = np.array(sources.targets.centers).T, np.array(sources.targets.radii)[1], sources.targets
    distance = np.linalg.norm(b - a) / 2
    part = targets.density(mi.Point3f((a + b) / 2), mi.Vector3f((b - a) / 2 / distance), False, True)[0]
    assert part * 2 * np.pi * (1 - np.sqrt(1 - (radius / distance) ** 2)) == pytest.approx(1, rel=1e-5)
    cube = mi.load_dict({"type": "cube", "to_world": T().scale(2)})
    assert bounding_sphere(cube)[3] == pytest.approx(MARGIN * 12**0.5)


#: With lobes of one direction.
SMOOTH = (
    {"type": "dielectric", "int_ior": 1.5},
    {"type": "prosim_composite", "diffuse_reflectance": 0.4},
    {"type": "mask", "opacity": 0.3, "bsdf": {"type": "twosided", "bsdf": {"type": "conductor", "material": "Cu"}}},
    DISPERSIVE,
)


@pytest.mark.parametrize("bsdf", SMOOTH, ids=lambda bsdf: bsdf["type"])
def test_a_beam_loses_as_much_from_either_end(variant_rgb, bsdf):
    """By rays of the eye, which follow each lobe, and by photons, which choose: but for the index squared."""
    bsdf, n = mi.load_dict(bsdf), 64
    light = lobes.only(lobes.SPECULAR)
    light.mode = mi.TransportMode.Importance
    number = dr.arange(mi.UInt32, n * n)
    there, back = dr.zeros(mi.SurfaceInteraction3f), dr.zeros(mi.SurfaceInteraction3f)
    cos = (0.5 + number // n) / n * dr.select(number % 2 == 0, 1, -1)
    there.wi = mi.Vector3f(dr.sqrt(1 - dr.square(cos)), 0, cos)
    found = 0
    for eye in map(lobes.only, (lobes.REFLECTED, lobes.REFRACTED)):
        a, weight = bsdf.sample(eye, there, (0.5 + number % n) / n, mi.Point2f(0.5))
        by_eye = ideal_throughput(a, weight, bsdf.flags())
        back.wi = a.wo
        b, weight = bsdf.sample(light, back, (0.5 + number * 5 % n) / n, mi.Point2f(0.5))
        by_light = ideal_throughput(b, weight, bsdf.flags()) * dr.square(b.eta)
        lost = (a.pdf == 0) | (b.pdf == 0) | ((a.sampled_type & eye.type_mask) == 0)
        met = ~lost & (dr.norm(b.wo - there.wi) < 1e-4)
        assert dr.all(~met | (dr.abs(by_eye - by_light) < 0.01 * by_light))
        found += dr.count(met)[0]
    assert found > n


# ---------------------------------------------------------------- the right light


#: Beams that are narrower than the floor that is looked at.
BALLS = {"ball in a cone": {"distribution": "cone", "angle": 3.0}}
BALLS["ball as a spot"] = {"distribution": "spot", "exponent": 600.0}
#: Lamps that are tested together.
KINDS = [("point", "directional"), ("prosim_point", "spot", "projector"), tuple(BALLS)]


@alone()
def test_the_shares_of_all_ways_to_find_a_path_add_up_to_one(variant_rgb):
    """From rough metal into glass, out of it and to a lamp: by rays, and by photons on the metal."""
    glass = ball({"type": "prosim_dielectric", "int_ior": 1.5}, (0, 1.2, 0), 0.8)
    world = scene(128, floor=ground(6, ROUGH), ball=glass, lamp=lamp(2.5, center=(0, 5, -2)), rays={"type": "prosim"})
    caustics = Caustics.of(world, world.sensors()[0], 1, 7, True)
    photons, caustics.sources.per_pair = caustics.mis, mi.Float(1000)
    n = 128 * 128
    random = [mi.Float(v) for v in np.random.default_rng(5).random((5, n), dtype=np.float32)]
    camera = world.sensors()[0].sample_ray(0, 0.5, mi.Point2f(*random[:2]), mi.Point2f(0.5))[0]
    ray, met, chain = world.integrator().transport(world, world.sensors()[0]).first(camera), mi.Bool(True), []
    ray.etendue = mi.Float(0)
    for k in range(3):
        si = world.ray_intersect(mi.Ray3f(ray.o, ray.d), met)
        bsdf, lobe = si.bsdf(), lobes.only(lobes.REFRACTED if k else lobes.REFLECTED)
        bs, weight = bsdf.sample(lobe, si, random[2], mi.Point2f(*random[3:]), met)
        met &= si.is_valid() & (bs.pdf > 0) & ((si.p.y > 0.01) if k else (si.p.y < 0.01))
        d = si.to_world(bs.wo)
        following = replace(ray, o=si.spawn_ray(d).o, d=d, pdf=mi.Float(0) if k else bs.pdf, n=viewer_side(si))
        vertex = Vertex(si, bsdf, met, mi.Bool(False), met, ray, Receiver(si, following.n))
        chain.append((vertex, bs))
        ray = photons.next(vertex, following, bs, weight)
    end, (last, _) = world.ray_intersect(mi.Ray3f(ray.o, ray.d), met), chain[-1]
    ds = mi.DirectionSample3f(world, end, last.si)
    met &= end.is_valid() & (ds.emitter != mi.EmitterPtr(None)) & (dr.dot(end.n, ray.d) < 0)
    density = caustics.sources.density(last.si, ds, met)
    of_ray = photons.emission_weight(ray, last.si, ds, met)
    light, one = lobes.only(lobes.REFRACTED, mi.BSDFContext(mi.TransportMode.Importance)), mi.Float(1)
    for level, (vertex, bs) in enumerate(reversed(chain[1:])):
        back = mi.SurfaceInteraction3f(vertex.si)
        back.wi = bs.wo
        d = -back.to_world(bs.wo)
        hit = Hit(back, vertex.bsdf, met, mi.Bool(False), d, mi.UInt32(level), mi.Spectrum(1), one, one, density)
        density, _ = photons.scatter(Landed.nowhere(), hit, *vertex.bsdf.sample(light, back, 0.5, mi.Point2f(0.5), met))
    vertex, bs = chain[0]
    cos = dr.abs(dr.dot(vertex.si.n, vertex.si.to_world(bs.wo)))
    of_photons = 1 - ray_weight(photons.footprint.area(vertex.si.p) * cos / bs.pdf * density)
    shares = np.array([of_ray, of_photons])[:, np.array(met)]
    assert shares.shape[1] > 100 and np.all(shares.max(axis=1) > 0.05)
    assert np.abs(shares.sum(axis=0) - 1).max() < 1e-3


ROUGHLY = {"type": "prosim_dielectric", "int_ior": 1.5, "alpha": 0.05}


@pytest.mark.slow
@pytest.mark.parametrize("glass", ({"type": "dielectric"}, ROUGHLY), ids=("smooth", "rough"))
def test_glass_in_a_closed_box_casts_all_the_light_that_it_gets_on_the_walls(variant_rgb, glass):
    """Walls of radiance 1 send pi times the surface of a ball into it. Facets that shade one another lose some, as much
    as the eye misses of an even sky that it sees through the ball.
    """
    thing = ball(glass, (0.2, 0.1, 0), 0.5)
    world = load_scene(sensor=view(4), walls={"type": "cube", "flip_normals": True} | area(), ball=thing)
    _, landed = traced(world, 1 << 17)
    power = dr.sum(dr.select(landed.valid, landed.flux.x, 0))[0]
    eye = parallel(32, 0.5, (0.2, 0.1, 2), (0.2, 0.1, 0), (0, 1, 0))
    world = load_scene(sensor=eye, sky={"type": "constant"}, ball=thing)
    paths = mi.load_dict({"type": "path", "max_depth": 100, "rr_depth": 100})
    missed = (1 - np.array(mi.render(world, integrator=paths, spp=64, seed=1)).mean()) * 4 / np.pi
    assert missed < 0.01
    assert power == pytest.approx(np.pi * 4 * np.pi * 0.5**2 * (1 - missed), rel=2e-3)


def upright_mirror(half, z=0.1):
    """A mirror in the plane x = 0."""
    place = T().translate((0, 1.1, z)).rotate((0, 1, 0), 90).scale((half, half, 1))
    return rectangle(place, bsdf={"type": "conductor", "material": "none"})


def mirrored(kind, channel):
    """A source without extent, or a small ball, in one colour: it lights the floor around (2, 0, 0) by a mirror at
    (0, 1.1, 0.1).
    """
    power = {"type": "rgb", "value": [3.0 * (k == channel) for k in range(3)]}
    place = T().look_at(origin=(1.5, 2, 0.2), target=(0, 1.1, 0.1), up=(0, 1, 0))
    if kind == "directional":
        return {"type": kind, "direction": (-2, -0.8, -0.1), "irradiance": power}
    if kind == "projector":
        picture = bitmap(np.full((4, 4, 3), power["value"]))
        return {"type": kind, "to_world": place, "irradiance": picture, "fov": 100}
    if kind in BALLS:
        beam = BALLS[kind] | {"type": "prosim_area", "direction": (-3.5, -2, -0.2), "radiance": power}
        return {"type": "sphere", "center": (1.5, 2, 0.2), "radius": 0.1, "emitter": beam}
    where = {"to_world": place, "cutoff_angle": 80, "beam_width": 79} if kind == "spot" else {"position": (1.5, 2, 0.2)}
    return {"type": kind, "intensity": power} | where


@pytest.mark.slow
@pytest.mark.parametrize("kinds", KINDS, ids="+".join)
def test_a_mirror_lights_a_floor_as_the_image_of_the_lamp_would(variant_rgb, kinds):
    """What paths find seldom or never: light of sources of little or no extent by way of a mirror. It comes to the
    floor as it would come to the floor's mirror image without the mirror, each source in a colour of its own.
    """
    # Of photons that are aimed at all of a mirror, a narrow beam has few; its edges are blurred by a pixel.
    half, size, photons = (0.3, 30, 1 << 20) if kinds[0] in BALLS else (0.6, 6, 1 << 19)
    mirror = upright_mirror(half)
    lamps = {f"lamp_{k}": mirrored(kind, k) for k, kind in enumerate(kinds)}
    world = scene(mirror=mirror, reflectance=1.0, **lamps)
    sensor = parallel(size, 0.3, (2, 5, 0), (2, 0, 0))
    all_light, direct = (render(world, 1, sensor, caustics=on, caustic_photons=photons) for on in (True, False))
    by_mirror = (all_light - direct).mean(axis=(0, 1))
    x, z = np.meshgrid(*[(np.arange(240) + 0.5) / 400 - 0.3] * 2)
    it = dr.zeros(mi.SurfaceInteraction3f, x.size)
    it.p = mi.Point3f(-2 - x.ravel(), 0, z.ravel())
    points = mi.Point2f(*np.random.default_rng(1).random((2, x.size)))
    for k, kind in enumerate(kinds):
        shapes = {e: e.get_shape() for e in world.emitters()}
        emitter = next(e for e, shape in shapes.items() if f"lamp_{k}" in (e.id(), shape and shape.id()))
        ds, irradiance = emitter.sample_direction(it, points)
        expected = np.mean(np.array(irradiance)[k] * np.abs(np.array(ds.d.y))) / np.pi
        assert abs(by_mirror[k] / expected - 1) < (0.04 if kind in BALLS else 0.02)  # some thousand photons


@pytest.mark.slow
@pytest.mark.parametrize("bsdf, level", [(ROUGH, 1), ({"type": "diffuse"}, 0)], ids=["rough metal", "diffuse"])
def test_a_mirror_lights_a_floor_as_another_sun_would(variant_rgb, tmp_path, bsdf, level):
    """Vertex normals are tilted against the facets: those of the mirror down, those of the floor to the mirror."""
    sensor = parallel(6, 0.3, (3.2, 3, 0), (1.2, 0, 0))
    sun, n = np.array([-2, -0.8, -0.1]), np.array([0.985, -0.174, 0])
    normals = [np.tile(normal, 4) for normal in ((0, -0.174, 0.985), (-0.26, 0, 0.966))]
    mirror, floor = (write_square(tmp_path / f"{k}.ply", normals=normal) for k, normal in enumerate(normals))
    upright = T().translate([0, 1.1, 0.1]).rotate([0, 1, 0], 90).scale(0.6)
    mirror = {"mirror": mirror | {"to_world": upright, "bsdf": {"type": "conductor", "material": "none"}}}
    floor |= {"to_world": T().rotate([1, 0, 0], -90).scale(6), "bsdf": bsdf}
    images, met = [], sun - 2 * (sun @ n) * n
    # Level 0 has no light of two specular surfaces, the mirror and rough metal.
    for caustics, most, d, things in ((True, level, sun, mirror), (level > 0, 0, sun, mirror), (False, 0, met, {})):
        world = scene(floor=floor, lamp={"type": "directional", "direction": d.tolist()}, **things)
        image = render(world, 1, sensor, caustics=caustics, caustic_photons=1 << 17, max_level=most)
        images.append(image.mean(axis=(0, 1)))
    assert np.allclose(images[0] - images[1], images[2], rtol=0.02)  # some thousand photons


def compared(ours, theirs, mask):
    """``(z, ratio)`` of images in the first channels: differences of 12 parts of the image over their error, and of the
    whole as a ratio.
    """
    parts = np.array_split(np.flatnonzero(mask), 12)
    x, y = (np.stack([[image.ravel()[part].mean() for part in parts] for image in images]) for images in (ours, theirs))
    error = np.sqrt((x.var(axis=0, ddof=1) + y.var(axis=0, ddof=1)) / len(ours))
    return (x.mean(axis=0) - y.mean(axis=0)) / error, x.mean() / y.mean() - 1


#: Pixels along the edge of images that are compared with paths. The kernel moves light across the edge of a caustic: by
#: 0.9 % of the light of one region at 24 pixels, by less than 0.05 % at 96.
FINE = 96


def agree(world, seen, seeds=10, kind="path"):
    """Whether the light is that of paths in every colour, as far as these have colours of their own."""
    paths = mi.load_dict({"type": kind, "max_depth": 20, "rr_depth": 50})
    ours = np.stack([render(world, seed, samples=2, caustic_photons=1 << 17) for seed in range(seeds)])
    theirs = np.stack([np.array(mi.render(world, integrator=paths, seed=1000 + seed, spp=64)) for seed in range(seeds)])
    for channel in range(3) if mi.is_spectral else (1,):
        z, ratio = compared(ours[..., channel], theirs[..., channel], seen)
        assert np.abs(z).max() < 6, (channel, z)  # t of some 15 degrees of freedom
        assert abs(ratio) < 0.01


def floor_alone(world):
    """The pixels that see the floor, and whose neighbours do."""
    size = world.sensors()[0].film().size()[0]
    grid = (np.arange(4 * size) + 0.5) / (4 * size)
    x, y = np.meshgrid(grid, grid)
    ray, _ = world.sensors()[0].sample_ray(0, 0.5, mi.Point2f(x.ravel(), y.ravel()), mi.Point2f(0.5))
    si = world.ray_intersect(ray)
    seen = np.array(si.is_valid() & (dr.abs(si.p.y) < 1e-4)).reshape(size, 4, size, 4).all(axis=(1, 3))
    around = np.pad(seen, 1)
    return np.all([around[j : j + size, i : i + size] for i in range(3) for j in range(3)], axis=0)


WHOLE = {"type": "principled", "base_color": 0.9, "roughness": 0.3, "spec_trans": 1.0, "eta": 1.5}
#: name -> (material of the ball, lamp): such that paths find their light often enough to be compared with.
CASES = {
    "glass": ({"type": "dielectric"}, lamp()),
    "rough glass": ({"type": "prosim_dielectric", "int_ior": 1.5, "alpha": 0.2}, lamp()),
    "rough metal": ({"type": "prosim_conductor", "material": "Cu", "alpha": 0.15}, lamp()),
    "taken whole, under a sky": (WHOLE, {"type": "constant", "radiance": 1.0}),
    "through a slab, on what is taken whole": ({"type": "dielectric"}, lamp()),
}


def specks(image, by=0.05):
    """Number of isolated bright pixels: those whose displayed luminance exceeds each of the 8 around by ``by``."""
    shown = np.where(image <= 0.0031308, 12.92 * image, 1.055 * np.maximum(image, 0.0031308) ** (1 / 2.4) - 0.055)
    y = np.clip(shown, 0, 1) @ (0.2126, 0.7152, 0.0722)
    h, w = y.shape
    padded = np.pad(y, 1, mode="edge")
    around = [padded[j : j + h, i : i + w] for j in range(3) for i in range(3) if (i, j) != (1, 1)]
    return int((y > np.max(around, axis=0) + by).sum())


@pytest.mark.slow
def test_photons_of_a_large_glossy_floor_are_no_specks(variant_rgb):
    """Few of the photons that a floor reflects come to what is seen. They made some ten specks an image; now there are
    as few as without photons, but for two in four images.
    """
    gloss = {"type": "prosim_phong", "diffuse_reflectance": 0.4, "specular_reflectance": 0.2, "exponent": 60.0}
    paint = {"type": "prosim_composite", "diffuse_reflectance": 0.3, "int_ior": 1.5, "exponent": 40.0}
    world = scene(
        100,
        sensor=view(100, (0.3, 1.2, 5), (0, 0.7, 0), 28),
        floor=ground(14, gloss),
        body={"type": "cylinder", "p0": (0, 0, 0), "p1": (0, 0.9, 0), "radius": 0.3, "bsdf": paint},
        head=ball({"type": "dielectric"}, (0, 1.25, 0), 0.33),
        lamp=lamp(0.3, 350.0, (-3, 4.5, 3.5)),
    )
    found = []
    for on in (True, False):
        images = [render(world, k, samples=5, caustics=on, caustic_photons=1 << 18) for k in range(4)]
        found.append(sum(map(specks, images)))
    assert found[0] <= found[1] + 2


@pytest.mark.slow
def test_rough_metal_sees_the_highlights_of_glass_without_fireflies(variant_rgb):
    """Light of a lamp by way of glass, shared by the rays of the rough metal's lobe and photons: as bright as by paths;
    and where the lamp is small, the errors of one pixel in a thousand are less than a third of those of the rays alone.
    """
    things = {"floor": ground(6, ROUGH), "glass": ball({"type": "dielectric"}, (0.5, 0.9, 0), 0.6)}
    world = scene(FINE, lamp=lamp(1.0, 20.0), **things)
    agree(world, floor_alone(world))
    world = scene(24, lamp=lamp(0.2, 500.0), **things)
    seen = floor_alone(world)
    shared = np.stack([render(world, seed)[seen] for seed in range(12)])
    alone = np.stack([render(world, 100 + seed, caustics=False)[seen] for seed in range(12)])
    worst = [np.percentile(np.abs(images - shared.mean(axis=0)), 99.9) for images in (shared, alone)]
    assert worst[0] < worst[1] / 3


def slab():
    """A pane of glass that the camera looks through, at right angles, so that what is behind it stays in its place."""
    place = T().look_at(origin=(0, 10 / 3, 5), target=(0, 0, 0), up=(0, 1, 0)).scale((0.6, 0.6, 0.05))
    return {"type": "cube", "to_world": place, "bsdf": {"type": "dielectric"}}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_the_light_is_that_of_paths_region_by_region(variant_rgb, case):
    """On a floor so dark that it lights nothing itself, the tree and its photons know all of the light."""
    bsdf, source = CASES[case]
    world = scene(FINE, reflectance=3e-4, thing=ball(bsdf), lamp=source)
    seen = floor_alone(world)
    if case.startswith("through a slab"):
        world = scene(FINE, thing=ball(bsdf), lamp=source, slab=slab(), floor=floor(3e-4, "principled"))
    agree(world, seen)


@pytest.mark.slow
def test_wavelengths_go_their_ways_as_those_of_paths(variant_spectral):
    """Glass that absorbs and disperses, under a white lamp: photons have the wavelengths of their samples."""
    absorbed = {"type": "rgb", "value": [1.0, 0.3, 0.75]}
    medium = {"type": "homogeneous", "albedo": 0.0, "sigma_t": absorbed, "scale": 2.0}
    world = scene(FINE, reflectance=3e-4, thing=ball(DISPERSIVE) | {"interior": medium}, lamp=lamp())
    agree(world, floor_alone(world), kind="volpath")


@pytest.mark.slow
def test_nothing_is_counted_twice_by_paths(variant_rgb):
    """A white box, roughly varnished, with a glass ball, its floor taken whole: photons in the place of what paths
    would have found, or shared with them.
    """
    varnished = {"type": "prosim_composite", "diffuse_reflectance": 0.6, "alpha": 0.3}
    flat = T().translate((0, 0.01, 0)).rotate((1, 0, 0), -90)
    above = T().translate((0, 1.9, 0)).rotate((1, 0, 0), 90).scale(0.6)
    world = load_scene(
        sensor=view(12, (0, 1, 0.95), (0, 0.9, -1), 70),
        box={"type": "cube", "flip_normals": True, "to_world": T().translate((0, 1, 0)), "bsdf": varnished},
        carpet=rectangle(flat, bsdf={"type": "principled", "base_color": 0.7}),
        ball=ball({"type": "dielectric"}, (0.1, 0.5, -0.3), 0.4),
        lamp=rectangle(above, bsdf={"type": "diffuse", "reflectance": 0.0}, **area(5.0)),
    )
    every = {"diffuse_bounces": -1, "max_level": -1}
    ours = np.stack([render(world, seed, samples=10, **every)[..., 1] for seed in range(10)])
    theirs = np.stack([render(world, 1000 + seed, samples=16, caustics=False, **every)[..., 1] for seed in range(10)])
    z, ratio = compared(ours, theirs, np.ones((12, 12), dtype=bool))
    assert np.abs(z).max() < 6
    assert abs(ratio) < 0.01


@pytest.mark.parametrize("kind", ["dielectric", "diffuse"])
def test_a_warning_names_specular_materials_with_mapped_normals(variant_rgb, logged, kind):
    """Their photons had 16 % too much light where the map tilts the normal by 45 degrees."""
    mapped = {"type": "normalmap", "id": "waves", "normalmap": bitmap(FLAT), "bsdf": {"type": kind}}
    world = small(4, thing=rectangle(T(), bsdf=mapped))
    Caustics.of(world, world.sensors()[0], 16, 3, tree=False)
    assert ["'waves' may scatter too much" in text for _, text in logged] == [True] * (kind == "dielectric")
