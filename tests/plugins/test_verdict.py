"""The verdict on a render names the cause of a fault."""

import re
import time
from pathlib import Path
from types import SimpleNamespace

import mitsuba as mi
import mitsuba_prosim
import numpy as np
import prosim_scene
import pytest
from mitsuba_prosim.explaining.explanation import Samples
from mitsuba_prosim.explaining.noise import rarely_met
from mitsuba_prosim.explaining.verdict import denoised_words, verdict
from mitsuba_prosim.photons.caustics import Caustics
from mitsuba_prosim.scene.black import lost_behind_glass, reason
from scenes import T, area, camera, diffuse, film, kernels, rectangle, rgb

PATH = {"type": "path", "max_depth": 6}
PATHS = {"type": "prosim", "diffuse_bounces": -1, "max_level": 6}
EXAMPLES = Path(__file__).parents[2] / "examples"
GLASS, MIRROR = {"type": "dielectric"}, {"type": "conductor", "material": "none"}
FROSTED = {"type": "roughdielectric", "alpha": 0.02}
COPPER = {"type": "roughconductor", "material": "Cu", "alpha": 0.03}
FOG = {"type": "homogeneous", "albedo": 0.9, "sigma_t": 2.0}
POINT = {"type": "point", "position": [0, 1, 0], "intensity": rgb(20, 20, 20)}
SUN = {"type": "directional", "direction": [0.3, -1, 0.1], "irradiance": rgb(3, 3, 3)}
CLEAR = {"type": "mask", "opacity": 0.0, "b": {"type": "diffuse"}}
HIDING = {"type": "path", "hide_emitters": True}
SKY = {"sky": {"type": "constant", "radiance": rgb(0.3, 0.3, 0.3)}}


def ball(bsdf, center=(0, 1, 0), radius=1):
    return {"type": "sphere", "center": list(center), "radius": radius, "bsdf": bsdf}


def bulb(center=(2, 5, 0), radius=0.12, radiance=200.0):
    return {"bulb": {"type": "sphere", "center": list(center), "radius": radius} | area(radiance)}


def panel():
    to_world = T().translate([0, 6, 0]).rotate([1, 0, 0], 90).scale(3)
    return {"panel": {"type": "rectangle", "to_world": to_world} | area(0.4)}


def pane(bsdf, scale=4):
    to_world = T().translate([0, 2.2, 0]).rotate([1, 0, 0], -90).scale(scale)
    return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf}


def cloud(radius=1):
    return {"cloud": ball({"type": "null"}, radius=radius) | {"interior": FOG}}


def scene(integrator=PATH, target=(0, 0.5, 0), origin=(0, 3, 7), **things):
    """A floor, a chalk ball, which has no fault, and ``things``; 32 x 32 pixels."""
    floor = {"type": "rectangle", "to_world": T().rotate([1, 0, 0], -90).scale(6), "bsdf": diffuse(0.6, 0.6, 0.6)}
    sensor = camera(origin, target, film(32), fov=40)
    chalk = ball(diffuse(0.5, 0.5, 0.5), (-2.5, 0.5, 0), 0.5)
    return {"type": "scene", "integrator": integrator, "sensor": sensor, "floor": floor, "chalk": chalk} | things


def faults():
    """Scenes with a fault, and what the verdict must say."""
    return [
        (scene(vase=ball(GLASS), **bulb()), "light of bulb by way of vase"),
        (scene(vase=ball(FROSTED), **bulb()), "light of bulb by way of vase"),
        (scene(vase=ball(COPPER), **bulb()), "light of bulb by way of vase"),
        (scene(PATHS, vase=ball(GLASS), **bulb()), "light of bulb by way of vase"),
        (scene(vase=ball(GLASS), **bulb(), **panel()), "light of bulb by way of vase"),
        (scene(vase=ball(GLASS), **bulb(), **SKY), "light of bulb by way of vase"),
        (scene(vase=ball(GLASS, (0, 3, 0), 0.5), **bulb((0, 3, 0), 0.1)), "light of bulb by way of vase"),
        (
            scene(vase=ball(MIRROR), **bulb(radius=0.01, radiance=5e4)),
            "a small lamp, bulb, in mirrors or behind glass, such as vase",
        ),
        (scene(pane=pane({"type": "thindielectric"}), **bulb((0, 4, 0), 0.05, 900.0)), "light of bulb through pane"),
        (scene(pane=pane(FROSTED), **bulb((0, 4, 0), 0.1, 300.0)), "light of bulb by way of pane"),
        (scene({"type": "path", "max_depth": 3}, vase=ball(GLASS), **bulb()), "Within glass, max_depth = 3 ends rays"),
        (scene(**cloud(), **bulb()), "PathIntegrator ignores the media of the scene: take volpath"),
        (
            scene({"type": "volpath", "max_depth": 6}, **cloud(), **bulb((0, 1, 0), 0.05, 300.0)),
            "medium in cloud scatters or absorbs light",
        ),
    ]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_verdict_names_the_cause_of_a_planted_fault():
    """Of all but two; it never names a thing without a fault."""
    mi.set_variant("llvm_ad_rgb")
    verdicts = [
        (says, mitsuba_prosim.render(mi.load_dict(made), spp=64, progress=False).verdict) for made, says in faults()
    ]
    assert not [verdict for _, verdict in verdicts if "chalk" in verdict or "panel" in verdict or "sky" in verdict]
    assert not [verdict for says, verdict in verdicts if "way of floor" in verdict]
    missed = [(says, verdict) for says, verdict in verdicts if says not in verdict]
    assert len(missed) <= 2, missed


def black():
    """Scenes whose image is black, and the reason."""
    hiding, soot, deep = {"type": "prosim_adaptive", "nested": HIDING}, diffuse(0, 0, 0), PATHS | {"max_level": -1}
    overhead, above = bulb((0, 9, 0)), rectangle(T().translate([0, 20, 0]).rotate([1, 0, 0], 90).scale(600))
    mirrored = {"floor": pane(MIRROR), "chalk": pane(MIRROR), "above": above} | overhead
    shade, opaque = ball(diffuse(0.2, 0.2, 0.2), radius=1.5), {"type": "mask", "opacity": 1.0, "b": {"type": "diffuse"}}
    both, below = {"type": "twosided", "b": {"type": "diffuse"}}, {"origin": (0, -4, 7)}
    crop = scene(chalk=POINT, floor=ball(soot))
    crop["sensor"]["film"] |= {"width": 320, "crop_width": 8}
    other = scene(target=(0, 0.5, 14), **overhead) | {"second": camera((0, 3, 7), (0, 0, 0), film(8))}
    upwards = {"type": "spot", "to_world": T().look_at([0, 5, 0], [0, 9, 0], [1, 0, 0])}
    distant, dense = scene(**overhead), FOG | {"sigma_t": 90.0}
    distant["sensor"]["far_clip"] = 1.0
    dark = {"type": "area", "radiance": {"type": "bitmap", "bitmap": mi.Bitmap(np.zeros((4, 4, 3), np.float32))}}
    return [
        (scene(), "the scene has no lights"),
        (distant, "the camera's far_clip cuts off 66% of the picture"),
        (scene(dark=pane({"type": "diffuse"}) | {"emitter": dark}), "the lights are off: radiance of dark is 0"),
        (
            scene({"type": "volpath"}, mud=ball({"type": "null"}, radius=50) | {"interior": dense}, **overhead),
            "the medium in mud lets no light through",
        ),
        (scene({"type": "aov", "aovs": "dd:depth"}), "only its channels, such as dd.T"),
        (scene(target=(0, 0.5, 14), **overhead), "nothing is in view"),
        (scene(origin=(-2.5, 0.5, 0), target=(0, 0.5, 0), **overhead), "the eye is within a solid"),
        (scene(spot=upwards), "the lights shine elsewhere"),
        (scene(vase=ball(GLASS), bulb=POINT), "only through glass or a mask, such as vase, "),
        (scene(pane=pane(GLASS, 9), sun=SUN), "only through glass or a mask, such as pane, "),
        (scene({"type": "path", "max_depth": 1}, **overhead), "max_depth = 1 ends all rays"),
        (scene({"type": "direct"}, **mirrored), "the integrator direct, unlike path, ends all rays"),
        (scene({"type": "prosim", "max_level": 0}, **mirrored), "max_level = 0 ends all rays"),
        (
            scene({"type": "path", "max_depth": 2}, floor=pane(soot), chalk=pane(soot), **overhead),
            "which reflects nothing",
        ),
        (scene(deep, floor=pane(soot), chalk=pane(soot), **overhead), "which reflects nothing"),
        (scene(hiding, (0, 20, 0), **bulb((0, 20, 0), 30)), "hide_emitters of the integrator hides them"),
        (scene(HIDING, (0, 20, 0), sky=SKY["sky"]), "hide_emitters of the integrator hides them"),
        (scene(floor=pane(CLEAR), chalk=pane(CLEAR), **overhead), "masks with nothing"),
        (scene(vase=ball(diffuse(0.2, 0.2, 0.2), (2, 5, 0), 0.5), **bulb()), "such as that of vase: are the lights"),
        # Light that arrives at the other side of a surface does not count,
        (scene(room=ball(diffuse(0.5, 0.5, 0.5), radius=40), sky=SKY["sky"]), "such as that of room: "),
        (scene(room=ball(both, radius=40), floor=pane(both, 60), sun=SUN), "such as that of room: "),
        (scene(origin=(-2.5, 0.5, 0), chalk=ball(both, (-2.5, 0.5, 0), 0.5), **overhead), "such as that of chalk: "),
        (scene(floor=pane(both, 60), chalk=pane(both), **below, sun=SUN), "other side of the visible surfaces"),
        (scene(floor=pane(both) | area(1), chalk=ball(both, (0, 3, 0), 0.1), **below), "other side of the visible"),
        # nor does light that only an opaque mask or an opaque thing around glass hides.
        (
            scene(origin=(0, 1, 7), screen=pane(opaque, 90), bulb=POINT | {"position": [0, 5, 0]}),
            "such as that of screen: ",
        ),
        (scene(vase=ball(GLASS), shade=shade, bulb=POINT), "they lie in shadow"),
        (crop, "nothing is in the crop window"),
        (other, "is another sensor of the scene meant?"),
    ]


@pytest.mark.slow
def test_black_image_has_a_reason(variant_rgb):
    for made, says in black():
        loaded = mi.load_dict(made)
        told = reason(loaded, loaded.sensors()[0], np.zeros((1, 1, 3)))
        assert says in told, told
    assert "negative" in reason(loaded, loaded.sensors()[0], np.full((1, 1, 3), -0.5))
    grey, light = (reason(loaded, loaded.sensors()[0], np.full((1, 1, 3), value)) for value in (1.4e-4, 1.6e-4))
    assert "its brightest value is 0.00014, white being 1" in grey and light is None


def test_reason_of_a_black_image_compiles_no_kernel_for_each_mirror(variant_rgb, monkeypatch):
    """They took half a minute, because each kernel computed again the way of the rays so far."""
    walls = ball(MIRROR, radius=40) | {"flip_normals": True}
    room = mi.load_dict(scene(walls=walls, floor=pane(MIRROR), chalk=pane(MIRROR), bulb=POINT))
    found = []
    for passed in (3, 16):
        monkeypatch.setattr("mitsuba_prosim.scene.black.PASSED", passed)
        found.append(kernels(lambda: reason(room, room.sensors()[0], np.zeros((1, 1, 3)))))
    assert found[1] <= found[0]


@pytest.mark.parametrize("weak, named", [({}, "bulb"), (bulb((-1, 5, 0), 0.3, 2.0), "lamps")])
def test_rarely_met_light_names_a_lamp_only_if_there_is_one(variant_rgb, weak, named):
    """Glass hides the weak lamp more often than the bright one, whose light it bends to the pixel."""
    made = mi.load_dict(scene(window=pane(GLASS, 1), **{f"weak {name}": lamp for name, lamp in weak.items()}, **bulb()))
    told = rarely_met(Samples(made, (16, 16), 64).recorder)
    assert told.startswith(f"the light of {named} through window, which only rays find")


@pytest.mark.parametrize("pixel_format", ["rgba", "luminance"])
def test_crop_window_of_a_grey_film_has_a_cause(variant_rgb, pixel_format):
    made = scene(vase=ball(GLASS), **bulb())
    crop = dict(zip(("crop_offset_x", "crop_offset_y", "crop_width", "crop_height"), (4, 5, 24, 22)))
    made["sensor"]["film"] |= crop | {"pixel_format": pixel_format}
    told = mitsuba_prosim.render(mi.load_dict(made), spp=64, progress=False).verdict
    assert "half of the error: the light of bulb by way of vase" in told


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_pixel_without_neighbours_has_a_verdict(variant_rgb):
    made = scene(PATHS, vase=ball(GLASS), **bulb())
    made["sensor"]["film"] |= {"width": 1, "height": 1}
    assert "has half of the error" in mitsuba_prosim.render(mi.load_dict(made), noise=0.5, progress=False).verdict


def test_cause_takes_the_photons_of_one_pass(variant_rgb, monkeypatch):
    """A pass has a million photons by default: 64 passes took a minute after a render of three seconds."""
    passes, use = [], Caustics.use_pass
    monkeypatch.setattr(Caustics, "use_pass", lambda self, *which: passes.append(which) or use(self, *which))
    integrator = PATHS | {"caustics": True, "caustic_photons": 5000, "samples": 2}
    made = mi.load_dict(scene(integrator, glass=ball(GLASS), **bulb()))
    render = made.integrator().progressive(made).run()
    passes.clear()
    words = verdict(render, integrator=made.integrator())
    assert "what would help" in words and "blur of photons" in words and len(passes) == 1


@pytest.mark.slow
def test_time_limit_leaves_out_the_cause(variant_rgb, monkeypatch):
    """Because it needs more time than is left."""
    monkeypatch.setattr("mitsuba_prosim.explaining.verdict.why_noisy", lambda *_: pytest.fail("is looked for"))
    made = mi.load_dict(scene(vase=ball(GLASS), **bulb()))
    mitsuba_prosim.render(made, noise=1, progress=False)  # compiles the kernels
    limited = mitsuba_prosim.render(made, noise=1e-5, time=0.5, progress=False)
    assert limited.verdict.startswith("reached the time limit") and "light of" not in limited.verdict


@pytest.mark.parametrize("launching, told", [(0.0, True), (19.0, False)])
def test_long_time_limit_leaves_time_for_the_cause(variant_rgb, launching, told):
    """Unless its kernels would take long to compile, as those of the image did."""
    limited = {"type": "prosim_adaptive", "nested": PATH, "noise": 1e-5, "max_samples": 64}
    made = mi.load_dict(scene(limited, vase=ball(GLASS), **bulb()))
    render = made.integrator().progressive(made).run()
    render.target.seconds, render.target.started = 200.0, time.perf_counter() - 200
    render.executor.launching = launching
    assert ("the light of bulb by way of vase" in verdict(render, integrator=made.integrator())) == told


@pytest.mark.parametrize("seconds, compiled, told", [(1.5, 1.4, True), (1.5, 0.4, False), (1.05, 9.4, False)])
def test_time_limit_that_compilation_exceeds_is_explained(variant_rgb, seconds, compiled, told):
    made = mi.load_dict(scene({"type": "prosim_adaptive", "nested": PATH, "time": 1.0, "max_samples": 2}, **panel()))
    late = made.integrator().progressive(made, made.sensors()[0]).run()
    late.target.started, late.executor.launching = time.perf_counter() - seconds, compiled
    assert (f"Kernels were compiled for {compiled} s" in verdict(late)) == told


def test_image_that_is_not_denoised_has_an_error(variant_rgb):
    made = mi.load_dict(scene({"type": "prosim_adaptive", "nested": PATH, "time": 1.0, "max_samples": 2}, **panel()))
    render = made.integrator().progressive(made, made.sensors()[0]).run()
    words = verdict(render, SimpleNamespace(why_raw="no time"))
    assert words.startswith("error unknown (a noise target would measure it), not denoised: no time")


def test_words_of_a_denoised_image_say_if_its_error_is_uncertain(variant_rgb):
    final = SimpleNamespace(why_raw=None, render=SimpleNamespace(half_images=lambda: [0]))
    final.denoiser = SimpleNamespace(sensor=mi.load_dict(camera([0, 0, 1], [0, 0, 0], film(1))))
    uncertain = "about 0.04, raw 0.1, uncertain: its error may be 0.05"
    for noise, says in (0.01, "at most 0.05, raw 0.1"), (0.04, uncertain), (0.048, "about 0.048, raw 0.1"):
        final.denoised = lambda noise=noise: SimpleNamespace(noise=noise, at_most=0.05, raw_noise=0.1)
        assert denoised_words(final) == f"denoised: error {says}"
    assert denoised_words(final, interrupted=True) == "not denoised: interrupted"


@pytest.mark.parametrize(
    "radiance, noise, told",
    [
        (4e6, 1e-4, "white being 1: dim"),
        (20, 0.5, "white being 1: dim"),
        (1, 1e-4, ""),
        (1e-3, 0.5, "white being 1: brighten all lights by 2^10"),
        (-1, 0.5, "are negative"),
    ],
)
def test_picture_with_unlikely_values_is_told(variant_rgb, radiance, noise, told):
    """Whether the noise is reached or not."""
    lamps = {"bulb": POINT} if radiance < 0 else {}
    lamps |= {"sky": {"type": "constant", "radiance": rgb(*[radiance] * 3)}}
    integrator = {"type": "prosim_adaptive", "nested": PATH, "max_samples": 8}
    end = mitsuba_prosim.render(mi.load_dict(scene(integrator, **lamps)), noise=noise, progress=False).verdict
    assert told in end and (" all lights " in end or "negative" in end) == bool(told)


def lacking():
    """Scenes, and which thing hides the light that they lack, if any."""
    tree, screen = {"type": "prosim"}, {"type": "mask", "opacity": 0.5, "b": {"type": "diffuse"}}
    caustics, rough = PATHS | {"caustics": True, "caustic_photons": 1000}, {"type": "roughdielectric", "alpha": 0.2}
    return [
        (scene(vase=ball(GLASS), bulb=POINT, **SKY), "vase"),
        (scene({"type": "direct"}, vase=ball(GLASS), bulb=POINT, **SKY), "vase"),
        (scene(PATHS, pane=pane(GLASS, 9), sun=SUN, **SKY), "pane"),
        (scene(pane=pane(screen, 9), sun=SUN, **SKY), "pane"),
        (scene(tree, vase=ball(GLASS, (2, 5, 0), 0.5), **bulb(), **SKY), "vase"),
        (scene(vase=ball(GLASS, (2, 5, 0), 0.5), **bulb(), **SKY), ""),  # paths meet the bulb,
        (scene(vase=ball(rough), bulb=POINT, **SKY), ""),  # and sample a point at rough glass; a tree does not
        (scene(tree, vase=ball(rough), bulb=POINT, **SKY), "vase"),
        (scene({"type": "direct"}, vase=ball(GLASS, (2, 5, 0), 0.5), **bulb(), **SKY), "vase"),
        (scene(vase=ball(GLASS, radius=0.1), sun=SUN, **SKY), ""),  # a small shadow
        (scene(pane=pane({"type": "diffuse"}, 9), vase=ball(GLASS), sun=SUN, **SKY), ""),
        (scene(caustics, vase=ball(GLASS), bulb=POINT, **SKY), ""),
    ]


@pytest.mark.slow
def test_light_that_is_lost_behind_glass_is_told(variant_rgb):
    """The error that is measured does not contain it."""
    for made, glass in lacking():
        told = mitsuba_prosim.render(mi.load_dict(made), spp=4, progress=False).verdict
        assert f"light is missing: through {glass}, only photons" in told or not (glass or "missing" in told), told
    # Here a lamp's point has a direction that is NaN, and no light.
    world = mi.load_dict(prosim_scene.load(EXAMPLES / "caustica.scn", resolution=(96, 72)))
    assert "light is missing: through surface_3" in lost_behind_glass(world, world.sensors()[0], paths=False)


def plainly_wrong():
    """Scenes with a fault, which no further samples mend, and the verdict, which is empty without a fault."""
    flat = {"type": "bitmap", "bitmap": mi.Bitmap(np.full((8, 8, 3), (128, 128, 255), np.uint8))}
    bumpy = {
        "type": "twosided",
        "b": {"type": "normalmap", "normalmap": flat | {"raw": False}, "b": {"type": "diffuse"}},
    }
    values = {"type": "bitmap", "bitmap": mi.Bitmap(np.full((8, 8, 3), (0.5, 0.5, 1), np.float32)), "raw": False}
    linear = {"type": "twosided", "b": {"type": "normalmap", "normalmap": values, "b": {"type": "diffuse"}}}
    volpath, fog, vast = {"type": "volpath"}, {"interior": FOG}, {"interior": FOG | {"sigma_t": 0.1}}
    shade, thin = ball(diffuse(0.2, 0.2, 0.2), (2, 5, 0), 0.5), {"interior": FOG | {"sigma_t": 1e-4}}
    near, far, within = (
        scene(**panel()),
        scene(**panel()),
        scene(volpath, cloud=ball({"type": "null"}, radius=30) | vast),
    )
    near["sensor"]["near_clip"], far["sensor"]["far_clip"], within["sensor"]["medium"] = 7.5, 7.5, vast["interior"]
    return [
        (scene(floor=pane(bumpy), **panel()), "normal map of floor is read as colours (sRGB)"),
        (near, "near_clip cuts off"),
        (far, "far_clip cuts off"),
        (
            scene({"type": "direct"}, vase=ball(MIRROR), **panel()),
            "In mirrors, such as vase, the integrator direct, unlike",
        ),
        (
            scene({"type": "path", "max_depth": 2}, vase=ball(MIRROR), **panel()),
            "such as vase, max_depth = 2 shows only",
        ),
        (scene({"type": "volpath", "max_depth": 3}, **cloud(), **panel()), "Within media, max_depth = 3 ends rays"),
        (
            scene(volpath, cloud=ball(diffuse(0.5, 0.5, 0.5)) | fog, **panel()),
            "medium in cloud is hidden by its surface",
        ),
        (scene(volpath, cloud=ball({"type": "null"}) | thin, **panel()), "medium in cloud is too thin to see"),
        (scene(volpath, cloud=ball({"type": "null"}, radius=30) | vast, **panel()), "The camera is within cloud"),
        (within | panel(), ""),
        (scene(floor=pane(linear), **panel()), ""),
        (scene(origin=(0, 1, 60), **panel()), ""),
        (scene(volpath, vase=ball(GLASS) | fog, bulb=POINT), "lamps without extent send through vase is missing"),
        (scene(vase=ball(MIRROR), bulb=POINT | {"position": [2, 5, 2]}), "lamps without extent send by way of vase"),
        (scene(vase=ball(MIRROR), **bulb((2, 5, 2))), ""),
        (scene(shade=shade, **bulb(), **SKY), "No direct light of bulb arrives at the visible surfaces: shade is in"),
        (scene(floor=scene()["floor"] | {"flip_normals": True}, **panel()), "such as floor show their inner side"),
        (scene(bulb=POINT | {"intensity": rgb(5, 5, 5), "position": [0, 40, 0]}), "brighten all lights"),
        (
            scene(
                up=rectangle(T().translate([0, 5, 0]).rotate([1, 0, 0], -90)) | area(9),
                dim=POINT | {"intensity": rgb(*[0.5] * 3)},
            ),
            "No direct light of up",
        ),
    ]


@pytest.mark.slow
def test_scene_that_is_plainly_wrong_is_told(variant_rgb):
    for made, says in plainly_wrong():
        told = mitsuba_prosim.render(mi.load_dict(made), noise=0.3, progress=False).verdict
        assert says in told and (says or not re.search("surfaces|normal|medium|clip|missing|darker", told)), told


def test_good_image_has_no_cause(variant_rgb):
    made = scene(PATH, **panel())
    good = mitsuba_prosim.render(mi.load_dict(made), noise=0.02, progress=False)
    assert good.verdict.startswith("error ") and "pixel" not in good.verdict


def with_gaps(share):
    """An image in which ``share`` of the values are NaN, the last ones."""
    values = np.full((8, 8, 3), 0.5, np.float32)
    values[int(8 * (1 - share)) :] = np.nan
    return {"type": "bitmap", "raw": True, "filter_type": "nearest", "bitmap": mi.Bitmap(values)}


@pytest.mark.parametrize("integrator", [PATH, PATHS], ids=["path", "prosim"])
@pytest.mark.parametrize("place", ["surface", "lamp", "sky"])
def test_samples_that_are_not_finite_are_told(variant_rgb, integrator, place):
    """They count as black, so an image that lacks light could pass for a good one."""
    things = panel()
    if place == "surface":
        things["floor"] = pane({"type": "diffuse", "reflectance": with_gaps(0.5)}, 6)
    elif place == "lamp":
        things["panel"]["emitter"]["radiance"] = with_gaps(0.5)
    elif place == "sky":
        things["sky"] = {"type": "envmap", "bitmap": with_gaps(0.5)["bitmap"]}
    made = mi.load_dict(scene(integrator, **things))
    told = mitsuba_prosim.render(made, spp=8, progress=False).verdict
    assert "of 8,192 samples are infinite or NaN, and count as black, most of them in the pixel " in told
    (name,) = {"surface": ["floor.bsdf.reflectance"], "lamp": ["panel.emitter.radiance"], "sky": ["sky"]}[place]
    assert f"{name}.data has such values" in told


def test_black_sky_is_told(variant_rgb):
    """Its samples may be NaN."""
    made = scene(sky={"type": "envmap", "bitmap": mi.Bitmap(np.zeros((8, 16, 3), np.float32))})
    told = mitsuba_prosim.render(mi.load_dict(made), spp=8, progress=False).verdict
    assert "data of sky is 0" in told


@pytest.mark.slow
def test_samples_of_both_halves_that_are_not_finite_are_told(variant_rgb, denoiser):
    things = panel() | {"floor": pane({"type": "diffuse", "reflectance": with_gaps(0.5)}, 6)}
    told = mitsuba_prosim.render(mi.load_dict(scene(PATH, **things)), spp=8, denoise=True, progress=False).verdict
    assert "of 8,192 samples are infinite or NaN" in told
