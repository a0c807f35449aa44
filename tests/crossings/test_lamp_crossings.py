"""Every shape of Mitsuba with every kind of lamp: all integrators find the light that scattered rays find.

The shapes are those of the installed Mitsuba, so new ones take part by themselves. Light that is lost or gained, noise
above that of scattered rays, NaN, and errors without a warning that names a lamp are failures.
"""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scenes import (
    COMPOUND,
    T,
    bitmap,
    camera,
    diffuse,
    film,
    ground,
    load_scene,
    plugins_of_mitsuba,
    rectangle,
    shape_of,
)

pytestmark = pytest.mark.slow

TEXELS = np.random.default_rng(5).random((4, 4, 3)) ** 2 * 20
BEAM = {"radiance": 5.0, "direction": [0.3, -1, 0.2]}
#: Kinds of lamps: the plugin, and its parameters. The bitmap is tiled, by texture coordinates or by ``to_uv``.
LAMPS = {
    f"{name} {kind}": (name, kind) for name in ("area", "prosim_area") for kind in ("number", "tiles", "attribute")
}
LAMPS |= {"cone": ("prosim_area", BEAM | {"distribution": "cone", "angle": 50.0})}
LAMPS |= {"spot": ("prosim_area", BEAM | {"distribution": "spot", "exponent": 3.0})}
#: Integrators, and the number of surfaces on the ways of their light: the floor and the lamp, perhaps a mirror.
PATHS = {"type": "prosim", "adaptive": "none", "max_level": 0, "diffuse_bounces": -1}
INTEGRATORS = {
    "tree": ({"type": "prosim", "adaptive": "none", "max_level": 0}, 2),
    "paths": (PATHS, 2),
    "caustics": ({"type": "prosim", "adaptive": "none", "max_level": 1, "caustics": True}, 3),
    "adaptive": ({"type": "prosim_adaptive", "path": {"type": "path", "max_depth": 2}}, 2),
}
#: Width of an image, and samples of a pixel.
SIZE, SAMPLES = 6, 1024
#: Distance between lamps: the light of one at the floor of the next is negligible.
APART = 60.0


def lamp(name, plugin, kind, shape):
    """The dictionary or the object of a lamp; None where ``shape`` has no such kind of lamp."""
    radiance = bitmap(TEXELS, filter_type="nearest") if kind == "tiles" else 5.0
    if kind == "attribute":
        if not mi.load_dict(shape).is_mesh():
            return None
        radiance = {"type": "mesh_attribute", "name": "vertex_color"}
    elif kind == "tiles" and "vertex_texcoords" not in mi.traverse(mi.load_dict(shape)):
        radiance["to_uv"] = mi.ScalarTransform3f().scale([3, 2])
    emitter = {"type": plugin, "id": name, **(kind if isinstance(kind, dict) else {"radiance": radiance})}
    result = mi.load_dict({**shape, "emitter": emitter})
    params = mi.traverse(result)
    if kind == "attribute":
        count = np.size(params["vertex_positions"]) if "vertex_positions" in params else 12
        result.add_attribute("vertex_color", 3, np.tile(np.float32([4, 5, 6]), count // 3))
    if kind == "tiles" and "vertex_texcoords" in params:
        params["vertex_texcoords"] = params["vertex_texcoords"] * 3 - 1
        params.update()
    return result


def lit(name, folder):
    """A scene with all kinds of lamps on the shape ``name``, each above its floor and before its mirror."""
    things, names, sensors = {}, [], {}
    for kind, (plugin, parameters) in LAMPS.items():
        x = APART * len(names)
        if (made := lamp(kind, plugin, parameters, shape_of(name, folder, (x, 2.5, 0)))) is None:
            continue
        names.append(kind)
        place = T().translate([x, 0, 0])
        things |= {
            kind: made,
            f"floor {kind}": ground(3, diffuse(0.8, 0.8, 0.8)) | {"to_world": place.rotate([1, 0, 0], -90).scale(3)},
            f"mirror {kind}": rectangle(place.translate([0, 2, -3]).scale(2), bsdf={"type": "conductor"}),
        }
        sensors[kind] = camera([x, 1.2, 7], [x, 0, 0.5], film(SIZE), fov=12)
    sensor = {"type": "batch", "film": film(SIZE * len(names), SIZE), **sensors}
    return load_scene(**things, sensor=sensor), names


def of_each_lamp(image, lamps):
    """The pixels (36,) of each lamp in an image that has them side by side."""
    return [part.ravel() for part in np.split(image, lamps, axis=1)]


def rays(scene, lamps, seed):
    """The light of each lamp that scattered rays find on ways over at most 2 surfaces, and over at most 3."""
    width = SIZE * lamps
    sampler, count = mi.load_dict({"type": "independent"}), SIZE * width * SAMPLES
    sampler.seed(seed, count)
    i = dr.arange(mi.UInt32, count) // SAMPLES
    position = (mi.Point2f(i % width, i // width) + sampler.next_2d()) / mi.Point2f(width, SIZE)
    ray, _ = scene.sensors()[0].sample_ray(0.0, 0.5, position, mi.Point2f(0.5))
    L, throughput, active, ways = mi.Spectrum(0), mi.Spectrum(1), mi.Bool(True), []
    for _ in range(3):
        si = scene.ray_intersect(ray, active)
        L += throughput * dr.select(active, si.emitter(scene).eval(si, active), 0)
        ways.append(dr.block_sum(dr.mean(L), SAMPLES) / SAMPLES)
        active &= si.is_valid()
        bs, weight = si.bsdf().sample(mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d(), active)
        throughput *= weight
        ray = si.spawn_ray(si.to_world(bs.wo))
    return [of_each_lamp(np.array(image).reshape(SIZE, width), lamps) for image in ways[1:]]


def statistics(images):
    """The mean of two images, its standard error, and the variance of a sample."""
    squares = np.square(images[0] - images[1])
    return np.mean(images), np.sqrt(squares.sum()) / 2 / squares.size, squares.mean() / 2 * SAMPLES


def found(integrator, scene, lamps, samples):
    """The statistics of the light that ``integrator`` finds of each lamp; texts of the error where it raises one."""
    try:
        images = [np.array(integrator.render(scene, seed=s, spp=samples))[..., :3] for s in (1, 2)]
    except RuntimeError as error:
        return [str(error)] * lamps
    return [statistics(pair) for pair in zip(*(of_each_lamp(image.mean(axis=2), lamps) for image in images))]


def failures(name, which, scene, lamps, by_rays, logged):
    """What is wrong with the ``lamps`` on the shape ``name`` in one of the :data:`INTEGRATORS`, beside the statistics
    ``by_rays`` of each; a warning excuses it.
    """
    integrator = mi.load_dict(INTEGRATORS[which][0])
    values = found(integrator, scene, len(lamps), 64 if which == "caustics" else SAMPLES)
    warned = [one for one in lamps if any(f"'{one}'" in text for _, text in logged)]
    for lamp, value, (expected, error, variance) in zip(lamps, values, by_rays):
        if isinstance(value, str):
            if not warned:
                yield f"{which}, {lamp} on {name}: {value}"
            continue
        tolerance = 6 * np.hypot(error, value[1]) + (0.06 if which == "caustics" else 0.03) * expected
        noisy = which != "caustics" and value[2] > 4 * 3.6 * variance
        if (not abs(value[0] - expected) <= tolerance or noisy) and lamp not in warned:
            yield f"{which}, {lamp} on {name}: {value}, scattered rays {expected, error, variance}"


@pytest.mark.parametrize("name", [name for name in plugins_of_mitsuba(mi.ObjectType.Shape) if name not in COMPOUND])
def test_every_lamp_lights_as_scattered_rays_find(variant_rgb, tmp_path, logged, name):
    """Of 36 pixels of two images each: the means differ by at most 6 standard errors (significance below 1e-6) and 3 %,
    or 6 % with photons, which are blurred; the variances by a factor of at most 4 (times 3.6: F's quantile 0.9999).
    """
    scene, lamps = lit(name, tmp_path)
    by_rays = [[statistics(pair) for pair in zip(*two)] for two in zip(*(rays(scene, len(lamps), s) for s in (3, 4)))]
    wrong = []
    for which, (_, surfaces) in INTEGRATORS.items():
        logged.clear()
        wrong += failures(name, which, scene, lamps, by_rays[surfaces - 2], logged)
    assert not wrong, "\n".join(wrong)
