"""Every BSDF of Mitsuba and of this package, by itself and within others, under every kind of lamp; and every sensor,
film, filter and medium: the images by ``prosim`` and ``prosim_adaptive`` have the mean of ``path``, and no more noise.

The plugins are those of the installed Mitsuba, so new ones take part by themselves. Light that is lost or gained, noise
of more than four times the variance, NaN, and refusals that are not in the tables below are failures.
"""

import gc

import mitsuba as mi
import numpy as np
import pytest
from image_statistics import cards
from mitsuba_prosim import registry
from scenes import FLAT, T, area, bitmap, film, load_scene, plugins_of_mitsuba, rectangle

pytestmark = pytest.mark.slow

#: Parameters of plugins that do not load without them.
NEEDED = {"hair": {"eumelanin": 0.2}}
#: BSDFs that are no material by themselves, or whose files of measurements Mitsuba does not have.
NOT_ALONE = {"blendbsdf", "bumpmap", "mask", "normalmap", "twosided", "measured", "measured_polarized"}
PARTNER = {"type": "diffuse", "reflectance": 0.4}
TILTED = FLAT * 0 + np.array((0.6, 0.55, 0.97))
WRAPPERS = {
    "alone": lambda bsdf: bsdf,
    "twosided": lambda bsdf: {"type": "twosided", "b": bsdf},
    "mask": lambda bsdf: {"type": "mask", "opacity": 0.6, "b": bsdf},
    "blendbsdf": lambda bsdf: {"type": "blendbsdf", "weight": 0.5, "a": PARTNER, "b": bsdf},
    "bumpmap": lambda bsdf: {"type": "bumpmap", "texture": bitmap(TILTED), "b": bsdf},
    "normalmap": lambda bsdf: {"type": "normalmap", "normalmap": bitmap(TILTED), "b": bsdf},
}
SKY = np.random.default_rng(2).random((4, 8, 3)) + 0.2
BLACK = {"type": "diffuse", "reflectance": 0.0}
LAMPS = ("constant", "envmap", "point", "area")
#: Each has every second material, because both turn the frame alike in our code, and all pairs take long.
MAPS = ("bumpmap", "normalmap")


def light(name):
    if name == "point":
        return {"type": name, "position": [3, 4, 20], "intensity": 900.0}
    if name == "area":
        return rectangle(T().translate([2, 3, 20]).rotate([1, 0, 0], 180).scale(9), bsdf=BLACK, **area(2.0))
    return {"type": name} | ({"radiance": 0.8} if name == "constant" else {"bitmap": mi.Bitmap(np.float32(SKY))})


PLACES = [("alone", lamp) for lamp in LAMPS]
PLACES += zip([*WRAPPERS][1:], ("area", "constant", "envmap", "area", "point"))
OURS = {
    "tree": {"type": "prosim", "adaptive": "none"},
    "paths": {"type": "prosim", "adaptive": "none", "max_level": -1, "diffuse_bounces": -1},
    "adaptive": {"type": "prosim_adaptive", "adaptive": "none", "nested": {"type": "path"}},
}
WAYS = OURS | {"paths by two rays": {"type": "prosim", "adaptive": "none", "diffuse_bounces": 8}}
#: Pixels of a side of a card, and samples of a pixel.
SIDE, SAMPLES = 12, 64


@pytest.fixture(autouse=True)
def without_shapes_of_other_tests():
    """Mitsuba's ``path`` asks all shapes of the process, also those that no lamp can have."""
    gc.collect()


def all_plugins(kind, base):
    """The plugins of one kind, of Mitsuba and of this package."""
    return {*plugins_of_mitsuba(kind), *(name for name, plugin in registry.PLUGINS.items() if issubclass(plugin, base))}


def materials():
    """Each BSDF that is a material by itself, by its name: with its default parameters, ours also rough."""
    names = sorted(all_plugins(mi.ObjectType.BSDF, mi.BSDF) - NOT_ALONE)
    found = {name: {"type": name, **NEEDED.get(name, {})} for name in names}
    for name in "composite", "conductor", "dielectric":
        found[f"rough {name}"] = {"type": f"prosim_{name}", "alpha": 0.3}
    return found | {"rough phong": {"type": "prosim_phong", "exponent": 20.0}}


def statistics(bsdfs, lamp, integrator):
    """``(mean, variance)`` of R, G and B for a card of each of ``bsdfs``: of a pixel with :data:`SAMPLES` samples."""
    pixels = cards(bsdfs, SIDE, {"lamp": light(lamp)}, spp=SAMPLES, first_seed=4, **integrator)[..., :3]
    assert np.isfinite(pixels).all()
    return pixels.mean(1), pixels.var(1, ddof=1)


def failures(names, expected, found):
    """The names of the cards whose mean differs by more than 5 standard errors (p < 0.002 for 3,000 comparisons), or
    whose standard deviation is greater than twice the expected one, and than 24 % of the mean for one sample: in the
    tree, the hole of a mask adds noise to glass without any.
    """
    (mean, variance), (own, noise) = expected, found
    error = np.sqrt((variance + noise) / SIDE**2)
    wrong = np.abs(own - mean) > 5 * error + 1e-3 * mean + 1e-5
    noisy = (noise > 4 * variance + np.square(0.03 * mean) + 1e-8).all(1)
    return {
        name: (mean[k].round(4), own[k].round(4), (noise[k] / (variance[k] + 1e-12)).round(2))
        for k, name in enumerate(names)
        if wrong[k].any() or noisy[k]
    }


@pytest.mark.parametrize("wrapper, lamp", PLACES)
def test_surface_looks_as_by_path(variant_rgb, wrapper, lamp):
    """A blend is compared with the mean of its materials: Mitsuba's blend of ideal and smooth lobes is biased."""
    cards, chosen = {}, [*materials().items()]
    for name, bsdf in chosen[MAPS.index(wrapper) :: 2] if wrapper in MAPS else chosen:
        if wrapper == "twosided" and mi.has_flag(mi.load_dict(bsdf).flags(), mi.BSDFFlags.Transmission):
            with pytest.raises(RuntimeError, match="without a transmission component"):
                mi.load_dict(WRAPPERS[wrapper](bsdf))
        else:
            cards[name] = bsdf
    wrapped = [WRAPPERS[wrapper](bsdf) for bsdf in cards.values()]
    expected = statistics(cards.values() if wrapper == "blendbsdf" else wrapped, lamp, {"type": "path"})
    if wrapper == "blendbsdf":
        mean, variance = statistics([PARTNER], lamp, {"type": "path"})
        between = np.square(expected[0] - mean) / 4 / SAMPLES
        expected = (expected[0] + mean) / 2, (expected[1] + variance) / 2 + between
    found = {way: statistics(wrapped, lamp, ours) for way, ours in WAYS.items()}
    inner = statistics(wrapped, lamp, {"type": "path"}) if wrapper == "blendbsdf" else expected
    # These find the light of hair by light sampling alone, and take the rays through a blended filter at random.
    noisy = np.isin([*cards], ["hair", "circular"] if wrapper == "blendbsdf" else ["hair"])[:, None]
    for way in "tree", "paths by two rays":
        found[way] = tuple(np.where(noisy, a, b) for a, b in zip(expected, found[way]))
    wrong = {way: failures(cards, inner if way == "adaptive" else expected, found[way]) for way in WAYS}
    assert not any(wrong.values()), wrong


def ball(sensor, integrator, **more):
    """10 images of a ball, under a lamp and a sky, that a ``sensor`` sees: array (10, height, width, channels)."""
    scene = load_scene(
        sensor=sensor,
        ball={"type": "sphere", "bsdf": PARTNER} | more,
        lamp={"type": "sphere", "center": [2, 3, 4], "radius": 0.5, "bsdf": BLACK, **area(20.0)},
        sky={"type": "constant", "radiance": 0.2},
    )
    integrator = mi.load_dict(integrator)
    return np.float64([mi.render(scene, integrator=integrator, seed=k, spp=64) for k in range(10)])


def assert_same_mean(sensor, ours, theirs, **more):
    """The means of all channels differ by less than 6 standard errors of 10 images, or by rounding."""
    expected = ball(sensor, theirs, **more).mean((1, 2))
    for integrator in ours:
        found = ball(sensor, integrator, **more).mean((1, 2))
        assert found.shape == expected.shape and np.isfinite(found).all()
        error = np.sqrt((found.var(0, ddof=1) + expected.var(0, ddof=1)) / 10)
        mean, own = expected.mean(0), found.mean(0)
        assert (np.abs(own - mean) < 6 * error + 1e-3 * mean + 1e-6).all(), (sensor["type"], integrator, mean, own)


FILM = film(4, component_format="float32")
SENSORS = "batch distant irradiancemeter orthographic perspective prosim_window radiancemeter thinlens"


def view(name="perspective", **more):
    """A sensor that sees the ball."""
    sensor = {"type": name, "to_world": T().look_at([0, 1, 6], [0, 0, 0], [0, 1, 0]), "film": FILM | more}
    if name == "thinlens":
        return sensor | {"aperture_radius": 0.1, "focus_distance": 5.0}
    if name == "batch":
        return {"type": name, "film": FILM | {"width": 8}, "a": view(), "b": view("orthographic")}
    if name in ("distant", "irradiancemeter", "radiancemeter"):
        one = {"type": name, "film": FILM | {"width": 1, "height": 1}}
        if name == "irradiancemeter":
            return rectangle(T().translate([0, 0, 3]), sensor=one)
        where = {"target": [0, 0, 0]} if name == "distant" else {"origin": [0, 1, 6]}
        return one | where | {"direction": [0, -0.1, -1]}
    return sensor


@pytest.mark.parametrize("name", SENSORS.split())
def test_sensor_sees_as_by_path(variant_rgb, name):
    assert {*SENSORS.split()} == all_plugins(mi.ObjectType.Sensor, mi.Sensor)
    assert_same_mean(view(name), OURS.values(), {"type": "path"})


def test_filter_as_by_path(variant_rgb):
    for name in plugins_of_mitsuba(mi.ObjectType.ReconstructionFilter):
        sensor = view(rfilter={"type": name}, pixel_format="rgba", sample_border=name != "box")
        assert_same_mean(sensor, [OURS["paths"]], {"type": "path"})


@pytest.mark.parametrize("name", ["homogeneous", "heterogeneous"])
def test_medium_as_by_volpath(variant_rgb, name):
    """Of any albedo within ``prosim_adaptive``; and by ``prosim`` where a homogeneous medium only absorbs light."""
    assert {*plugins_of_mitsuba(mi.ObjectType.Medium)} == {"homogeneous", "heterogeneous"}
    volpath = {"type": "volpath"}
    adaptive = OURS["adaptive"] | {"nested": volpath}
    for albedo in (0.7, 0.0) if name == "homogeneous" else (0.7,):
        density = {"sigma_t" if name == "homogeneous" else "scale": 0.7, "albedo": albedo}
        if name == "heterogeneous":
            grid = mi.VolumeGrid(np.ones((2, 2, 2, 1), np.float32))
            density["sigma_t"] = {"type": "gridvolume", "grid": grid, "to_world": T().translate(-1).scale(2)}
        ours = [adaptive] if albedo else [adaptive, OURS["tree"], OURS["paths"]]
        inside = {"type": name, **density}
        assert_same_mean(view(), ours, volpath, bsdf={"type": "null"}, interior=inside)
