"""Derivatives of images by the parameters of scenes: what they are, and of which samples."""

import gc

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from mitsuba_prosim.compat import to_world_name
from scenes import T, area, bitmap, camera, derivative, diffuse, film, ground, load_scene, mesh, penumbra, rgb


def weighted_mean(image):
    """A loss that is linear in the colours of the image, uneven over it."""
    image = mi.TensorXf(image)[..., :3]
    weights = np.linspace(0, 1, dr.prod(image.shape), dtype=np.float32).reshape(image.shape)
    return dr.mean(image * mi.TensorXf(weights), axis=None)


def image_of(scene, change, seed, spp):
    """A function of a ``mi.Float``: the image of the scene into which ``change(params, e)`` puts it."""
    params = mi.traverse(scene)

    def image(e):
        change(params, e)
        params.update()
        return mi.render(scene, params, seed=seed, seed_grad=seed + 1, spp=spp, spp_grad=spp)

    return image


def forward_derivative(scene, change, seed=1, spp=16):
    """The derivative of each value of the image by the ``mi.Float`` of :func:`image_of`, in forward mode."""
    e = mi.Float(0)
    dr.enable_grad(e)
    found = image_of(scene, change, seed, spp)(e)
    dr.forward(e)
    return np.array(dr.grad(found))


def derivatives(scene, change, seed=1, spp=16):
    """``(forward, backward)``: :func:`forward_derivative`, and the derivative of the image's weighted mean in reverse
    mode.
    """
    image = image_of(scene, change, seed, spp)
    return forward_derivative(scene, change, seed, spp), derivative(lambda e: weighted_mean(image(e)))


def central_difference(scene, change, h, measure):
    """That of what ``measure()`` returns, by the ``mi.Float`` of :func:`image_of`, at 0."""
    params, sides = mi.traverse(scene), []
    for e in (h, -h):
        change(params, mi.Float(e))
        params.update()
        sides.append(np.array(measure()))
    return (sides[0] - sides[1]) / (2 * h)


# ------------------------------------------------------------------ of which samples


@pytest.mark.slow
def test_derivative_by_a_linear_parameter_is_the_image(variant_rgb, capfd):
    """By the radiance of the only source that is not black, with adaptive counts and a crop window of several bands in
    a corner of the film, where its filter reaches pixels within the film and beyond it. Dr.Jit says nothing.

    What the integrator says of itself has no derivatives, and does not disturb those of the image.
    """
    dictionary = penumbra(None, 24, "gaussian", type="prosim", max_level=0, samples=3, band=100, aovs="samples,error")
    dictionary["dark"] = {"type": "envmap", "bitmap": mi.Bitmap(np.zeros((4, 8, 3), np.float32))}
    dictionary["black"] = ground(1, {"type": "roughconductor"}, emitter={"type": "area", "radiance": 0.0})
    window = {"crop_offset_x": 12, "crop_offset_y": 12, "crop_width": 12, "crop_height": 12}
    dictionary["sensor"]["film"] |= window | {"sample_border": True}
    scene = mi.load_dict(dictionary)
    image = np.array(mi.render(scene, seed=2))

    def change(params, e):
        params["light.emitter.radiance.value"] = mi.Color3f(25) * (1 + e)

    forward, backward = derivatives(scene, change, seed=1, spp=0)
    assert forward[..., :3] == pytest.approx(image[..., :3], rel=1e-4, abs=1e-6)
    assert np.all(forward[..., 3:] == 0) and image[..., 3].max() == pytest.approx(9) and capfd.readouterr().err == ""
    assert backward == pytest.approx(weighted_mean(image).array[0], rel=1e-4)


def test_batches_of_pixels_have_their_light_and_its_derivatives(variant_rgb, monkeypatch):
    """With any numbers of samples, in bands and in parts. Mitsuba's ``RayDataLoader`` expects all of them at once."""
    monkeypatch.setattr("mitsuba_prosim.engine.derivatives.LANES", 1000)
    scene = mi.load_dict(penumbra(None, 16, type="prosim", max_level=0, band=100))
    loader = mi.ad.loaders.RayDataLoader(scene.sensors(), [mi.render(scene, spp=256)], pixels_per_batch=256)
    target, batch = loader.next()
    params, scale = mi.traverse(scene), mi.Float(1)
    dr.enable_grad(scale)
    params["light.emitter.radiance.value"] = mi.Color3f(25) * scale
    params.update()
    image = mi.render(scene, params, sensor=batch)
    dr.forward(scale)
    for found in image, dr.grad(image):
        assert np.corrcoef(np.ravel(found), np.ravel(target))[0, 1] > 0.999 > np.max(target)


def test_time_is_refused(variant_rgb):
    scene = mi.load_dict(penumbra(None, 8, type="prosim", max_level=0, time=0.1))
    params = mi.traverse(scene)
    dr.enable_grad(params["light.emitter.radiance.value"])
    params.update()
    image = mi.render(scene, params)
    with pytest.raises(RuntimeError, match="set samples, max_samples or noise instead of time"):
        dr.backward(dr.mean(image, axis=None))


def test_a_render_by_the_integrator_itself_is_not_recorded(variant_rgb):
    """As with Mitsuba's ``prb``. Dr.Jit 1.5 crashes at exit while the film holds the recorded loops."""
    scene = mi.load_dict(penumbra(None, 8, type="prosim", samples=2))
    params = mi.traverse(scene)
    dr.enable_grad(params["light.emitter.radiance.value"])
    params.update()
    assert not dr.grad_enabled(scene.integrator().render(scene)) and dr.grad_enabled(mi.render(scene, params))


@pytest.mark.slow
def test_iterations_share_their_kernels(variant_rgb):
    """However long the paths are, and whatever the parameters: a step after the first compiles nothing."""
    bsdf = {"type": "prosim_conductor", "eta": 0.3, "k": 3.0, "alpha": 0.3}
    scene = mi.load_dict(penumbra(bsdf, 16, type="prosim", diffuse_bounces=-1, max_level=-1, adaptive="none"))
    params, key = mi.traverse(scene), "ball.bsdf.alpha.value"
    kernels = []
    gc.collect()  # kernels know of all scenes in memory
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        for seed in range(3):
            params[key] = dr.opaque(mi.Float, 0.3 + 0.01 * seed)
            dr.enable_grad(params[key])
            params.update()
            image = mi.render(scene, params, seed=seed, spp=4)
            dr.kernel_history_clear()
            dr.backward(dr.mean(dr.square(image), axis=None))
            history = [kernel for kernel in dr.kernel_history() if kernel.get("operation_count", 0) > 500]
            kernels.append({kernel["hash"] for kernel in history})
            assert len(kernels[-1]) <= 8 < len(history)  # the first two iterations and the last have their own
    assert kernels[0] == kernels[1] == kernels[2]


# ------------------------------------------------------------------ of sources, and what they light

FLOORS = {
    "diffuse": {"type": "diffuse", "reflectance": 0.6},
    "metal": {"type": "roughconductor", "alpha": 0.2},
    "conductor": {"type": "prosim_conductor", "eta": 1.5, "k": 2.0, "alpha": 0.3},
    "plastic": {"type": "roughplastic", "alpha": 0.2},
}


def lamp(kind):
    radiance = rgb(6, 5, 4)
    if kind == "textured":
        texels = np.random.default_rng(1).uniform(1, 9, (4, 4, 3))
        radiance = bitmap(texels, filter_type="nearest", wrap_mode="clamp")
    to_world = {
        "sphere": T().translate([0.3, 1.5, 0.5]).scale(0.5),
        "low sphere": T().translate([0.9, 0.35, 0.7]).scale(0.5),  # the horizon cuts it
    }.get(kind, T().translate([0.3, 1.6, 0.4]).rotate([1, 0, 0], 110).scale([0.5, 0.4, 1]))
    emitter = {"type": "area", "radiance": radiance}
    if kind == "mesh":
        corners = [to_world @ mi.ScalarPoint3f(x, y, 0) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        return mesh(corners, [(0, 1, 2), (0, 2, 3)], emitter=emitter)
    shape = "sphere" if "sphere" in kind else "rectangle"
    return {"type": shape, "to_world": to_world, "bsdf": diffuse(0, 0, 0), "emitter": emitter}


def spot(kind, floor, **settings):
    """A floor below a source, of which all pixels see one point; nothing is in the way of anything."""
    return load_scene(
        integrator={"type": "prosim", "adaptive": "none", "max_level": 0, **settings},
        sensor=camera([0, 3, -4], [0, 0, 0], film(32, pixel_format="rgb", component_format="float32"), fov=0.001),
        floor=ground(20, FLOORS[floor]),
        lamp=lamp(kind),
    )


def direct_light(scene, n=512):
    """Radiance of the floor by quadrature over the surface of the lamp."""
    ray, _ = scene.sensors()[0].sample_ray(0, 0.5, [0.5, 0.5], [0.5, 0.5])
    si = scene.ray_intersect(ray)
    shape = next(shape for shape in scene.shapes() if shape.is_emitter())
    i = dr.arange(mi.UInt32, n * n)
    uv = mi.Point2f((i % n + 0.5) / n, (i // n + 0.5) / n)
    at = shape.eval_parameterization(uv)
    area = dr.norm(dr.cross(at.dp_du, at.dp_dv)) / n**2
    d = at.p - si.p
    d2 = dr.squared_norm(d)
    d *= dr.rsqrt(d2)
    n_at = dr.normalize(at.p - shape.bbox().center()) if shape.class_name() == "Sphere" else at.n
    cos = dr.maximum(-dr.dot(n_at, d), 0)
    at.wi, at.t = mi.Vector3f(0, 0, 1), mi.Float(1)
    L = shape.emitter().eval(at)
    f = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(d))
    return np.array(f * L * (cos * area / d2), dtype=float).sum(axis=1).mean()


def moved(v):
    """Moves a shape along ``v``."""
    return lambda value, e: mi.Transform4f().translate(mi.Vector3f(v) * e) @ value


CHANGES = {
    "lamp moves": ("lamp.to_world", moved([1, 0.5, -0.7])),
    "lamp grows": ("lamp.to_world", lambda value, e: value @ mi.Transform4f().scale(1 + e)),
    "floor turns": ("floor.to_world", lambda value, e: mi.Transform4f().rotate([1, 0, 0.5], 20 * e) @ value),
    "floor rises": ("floor.to_world", moved([0, 1, 0])),
}


def change_of(scene, name):
    """What changes ``scene`` as the name in ``CHANGES`` says, by a ``mi.Float`` that is 0 where nothing changes."""
    key, by = CHANGES[name]
    params = mi.traverse(scene)
    if key.endswith("to_world"):
        key = to_world_name(params, key.removesuffix("to_world"))
    value = type(params[key])(params[key])
    return lambda params, e: params.update({key: by(value, e)})


RADIANCE = "lamp.emitter.radiance.value"
TREE, BOTH, PATH = {}, {"diffuse_bounces": 2}, {"diffuse_bounces": -1}


@pytest.mark.slow
@pytest.mark.parametrize("settings, key", [(TREE, RADIANCE), (PATH, RADIANCE), (TREE, "floor.bsdf.reflectance.value")])
def test_derivatives_by_colours_that_are_black(variant_rgb, settings, key):
    """The image is linear in the colour, so its derivative is the image of white: of the same samples, also at 0, where
    an optimiser that may not go below it would stay.
    """
    scene = spot("sphere", "diffuse", **settings)

    def change(params, e):
        params[key] = type(params[key])(e)

    forward, backward = derivatives(scene, change)
    change(params := mi.traverse(scene), 1)
    params.update()
    image = mi.render(scene, seed=2, spp=16)
    assert forward == pytest.approx(np.array(image), rel=1e-4) and np.all(forward > 0)
    assert backward == pytest.approx(weighted_mean(image).array[0], rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind, floor, change, settings",
    [
        ("textured", "diffuse", "lamp moves", PATH),
        ("textured", "diffuse", "floor turns", TREE),
        ("rectangle", "metal", "lamp grows", PATH),
        ("rectangle", "conductor", "floor rises", BOTH),
        ("sphere", "diffuse", "lamp grows", TREE),
        ("sphere", "conductor", "lamp moves", BOTH),
        ("low sphere", "plastic", "lamp moves", PATH),
    ],
)
def test_derivatives_match_quadrature(variant_rgb, kind, floor, change, settings):
    """Within 4 standard errors (of pixels, which are independent) and 0.1 % for the quadrature and its difference."""
    scene = spot(kind, floor, **settings)
    by = change_of(scene, change)
    expected = central_difference(scene, by, 0.01, lambda: direct_light(scene))
    forward, backward = derivatives(scene, by)
    error = forward.mean(axis=2).std() / 32
    assert abs(forward.mean() - expected) < 4 * error + 1e-3 * abs(expected)
    assert backward == pytest.approx(weighted_mean(forward).array[0], rel=1e-3)


@pytest.mark.slow
def test_a_stretched_mesh_has_the_derivatives_of_a_rectangle(variant_rgb):
    """Mitsuba's samples of a mesh know nothing of its change of area."""
    center = mi.ScalarPoint3f(0.3, 1.6, 0.4)

    def stretch(params, e):
        v = dr.unravel(mi.Point3f, value)
        params["lamp.vertex_positions"] = dr.ravel(center + (v - center) * (1 + e))

    scene = spot("mesh", "plastic", **PATH)
    value = mi.Float(mi.traverse(scene)["lamp.vertex_positions"])
    stretched = forward_derivative(scene, stretch)
    scene = spot("rectangle", "plastic", **PATH)
    rectangle = forward_derivative(scene, change_of(scene, "lamp grows"), seed=7)
    error = np.hypot(stretched.mean(axis=2).std(), rectangle.mean(axis=2).std()) / 32
    assert abs(stretched.mean() - rectangle.mean()) < 4 * error


@pytest.mark.slow
def test_derivatives_by_the_view_match_differences(variant_rgb):
    """By the field of view and the principal point together, in each pixel, of a floor without edges."""
    texture = bitmap(np.random.default_rng(1).uniform(0.1, 0.9, (8, 8, 3)))
    scene = load_scene(
        integrator={"type": "prosim", "adaptive": "none", "max_level": 0},
        sensor=camera([0, 3, -4], [0, 0, 0], film(4, pixel_format="rgb", component_format="float32"), fov=20),
        floor=ground(20, {"type": "diffuse", "reflectance": texture}),
        lamp=lamp("sphere"),
    )

    def change(params, e):
        params.update({"sensor.x_fov": 20 + 10 * e, "sensor.principal_point_offset_x": 0.1 * e})

    forward, backward = derivatives(scene, change)
    expected = central_difference(scene, change, 0.01, lambda: mi.render(scene, seed=2, spp=16))
    assert forward == pytest.approx(expected, abs=0.01 * float(np.abs(expected).max()))
    assert backward == pytest.approx(weighted_mean(forward).array[0], rel=1e-3)


# ------------------------------------------------------------------ of materials, with reflections and a sky


METAL = {"type": "prosim_conductor", "eta": 0.3, "k": 3.0}
PAINT = {"type": "prosim_composite", "diffuse_reflectance": 0.4, "specular_reflectance": 0.4, "alpha": 0.2}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name, ball, settings",
    [
        ("reflectance", None, {"rfilter": "gaussian", "diffuse_bounces": -1}),
        ("k", METAL, {}),
        ("alpha", METAL | {"alpha": 0.3}, {}),
        ("diffuse_reflectance", PAINT, {}),
    ],
)
def test_derivatives_match_finite_differences(variant_rgb, name, ball, settings):
    """Backward and forward, within 4 standard errors of 4 seeds and 2 % (differences see moving shadows as well)."""
    dictionary = penumbra(ball, size=16, **{"type": "prosim", "max_level": 1, **settings})
    del dictionary["pole"]
    dictionary["ball"] |= {"center": [0, 1, 0], "radius": 1.0}
    dictionary["sky"] = {"type": "constant", "radiance": rgb(0.2, 0.3, 0.4)}
    scene, key = mi.load_dict(dictionary), f"ball.bsdf.{name}.value"
    params = mi.traverse(scene)
    value = type(params[key])(params[key])

    def change(params, e):
        params[key] = value * (1 + e)

    def difference(seed):
        return central_difference(
            scene, change, 0.02, lambda: weighted_mean(mi.render(scene, seed=seed, spp=144)).array[0]
        )

    expected = np.array([difference(seed) for seed in range(4)])
    found = [derivatives(scene, change, 100 + seed, 144) for seed in range(4)]
    forward, backward = np.array([(weighted_mean(image).array[0], back) for image, back in found]).T
    error = np.sqrt((expected.var(ddof=1) + backward.var(ddof=1)) / 4)
    assert abs(backward.mean() - expected.mean()) < 4 * error + 0.02 * abs(expected.mean())
    assert forward == pytest.approx(backward, rel=1e-3, abs=1e-7)


# ------------------------------------------------------------------ of our materials in Mitsuba's prb


def below_a_sky(**bsdfs):
    """Spheres of ``bsdfs`` on a floor, in the light of an envmap with a sun, for ``prb``."""
    texels = np.random.default_rng(3).uniform(0.2, 1.5, (8, 16, 3)).astype(np.float32)
    texels[2, 4] = 200
    spheres = {
        name: {"type": "sphere", "center": [2.1 * i - 1.05 * (len(bsdfs) - 1), 1, 0], "bsdf": bsdf}
        for i, (name, bsdf) in enumerate(bsdfs.items())
    }
    return load_scene(
        integrator={"type": "prb", "max_depth": 4},
        sensor=camera([0, 2, 6], [0, 0.5, 0], film(32, 16), fov=25 * len(bsdfs)),
        sky={"type": "envmap", "bitmap": mi.Bitmap(texels)},
        floor=ground(10, {"type": "diffuse"}),
        **spheres,
    )


def gradients(scene, keys, spp=256):
    """The derivatives of the mean square of an image by each of the parameters ``keys``, as arrays."""
    params = mi.traverse(scene)
    for key in keys:
        dr.enable_grad(params[key])
    params.update()
    dr.backward(dr.mean(dr.square(mi.render(scene, params, spp=spp, seed=1)), axis=None))
    return [np.array(dr.grad(params[key])) for key in keys]


@pytest.mark.slow
def test_no_rounding_error_becomes_a_gradient(variant_rgb):
    """In prb the gradient by a pigment that is black in one channel is about that of the pigment alone, however little
    the lobe reflects there.
    """
    kd = rgb(0, 0.3, 0.6)
    painted = {"diffuse_reflectance": kd, "specular_reflectance": 0.3}
    bsdfs = {
        "beckmann": {"type": "prosim_composite", "alpha": 0.1, **painted},
        "gaussian": {"type": "prosim_composite", "distribution": "gaussian", "alpha": 0.5, **painted},
        "exponent": {"type": "prosim_composite", "exponent": 200, **painted},
        "phong": {"type": "prosim_phong", "exponent": 20, **painted},
        "lambertian": {"type": "prosim_lambertian", "reflectance": kd},
        "diffuse": {"type": "diffuse", "reflectance": kd},
    }
    keys = [f"{name}.bsdf.{'diffuse_' * ('diffuse_reflectance' in b)}reflectance.value" for name, b in bsdfs.items()]
    *ours, diffuse = gradients(below_a_sky(**bsdfs), keys)
    assert np.all(diffuse > 0)
    for name, gradient in zip(bsdfs, ours):
        assert np.all(np.abs(gradient) < 10 * diffuse), name


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [0.5, 0.01])
@pytest.mark.parametrize("kind, parameters", [("conductor", {"eta": 0.3, "k": 3.0}), ("dielectric", {"int_ior": 1.5})])
def test_gradients_are_no_larger_than_those_of_mitsubas_materials(variant_rgb, kind, parameters, alpha):
    """Within a factor of ten, in prb, whatever the distribution."""
    ours = {"type": f"prosim_{kind}", **parameters}
    bsdfs = {
        "stock": {"type": f"rough{kind}", **parameters, "alpha": alpha},
        "beckmann": {**ours, "alpha": alpha},
        "gaussian": {**ours, "alpha": alpha, "distribution": "gaussian"},
        "exponent": {**ours, "exponent": 2 / alpha**2 - 2},
    }
    scene = below_a_sky(**bsdfs)
    widths = ["alpha.value"] * 3 + ["exponent.value"]
    for names in (widths, *([name] * 4 for name in ("eta", "eta.value", "k.value"))):
        keys = [f"{sphere}.bsdf.{name}" for sphere, name in zip(bsdfs, names)]
        if keys[0] in mi.traverse(scene):
            stock, *found = (np.abs(gradient).max() for gradient in gradients(scene, keys))
            if names is widths:
                found[-1] *= 4 / alpha**3  # the exponent's derivative by alpha
            assert stock > 0 and max(found) < 10 * stock


@pytest.mark.slow
def test_derivative_of_million_samples_is_right(variant_rgb):
    """By the radiance of the sky, of which the image is a copy: floats of 32 bits would add up to 0.1 % too much."""
    pixels = film(1, pixel_format="rgb", component_format="float32") | {"rfilter": {"type": "gaussian"}}
    scene = load_scene(
        integrator={"type": "prosim", "adaptive": "none"},
        sensor=camera([0, 0, 4], [0, 0, 0], pixels),
        sky={"type": "constant", "radiance": rgb(0.1, 0.1, 0.1)},
    )
    params = mi.traverse(scene)
    dr.enable_grad(params["sky.radiance.value"])
    dr.set_grad(params["sky.radiance.value"], 1)
    assert np.allclose(np.array(scene.integrator().render_forward(scene, params, spp=1 << 20)), 1, rtol=1e-6)


def card_below_a_sky(bsdf, **others):
    """A card that fills the view, with ``others`` in the place of the integrator or the sky, or beside them."""
    things = {
        "integrator": {"type": "prosim", "diffuse_bounces": -1},
        "sensor": camera([0, 0, 5], [0, 0, 0], film(8), fov=10),
        "sky": {"type": "constant"},
        "card": {"type": "rectangle", "bsdf": bsdf},
    }
    return load_scene(**things | others)


@pytest.mark.slow
@pytest.mark.parametrize("diffuse_bounces", [0, 3, -1])
def test_derivative_by_the_weight_of_a_blend_with_ideal_lobes(variant_rgb, diffuse_bounces):
    """A card before a lamp of radiance 2, in a sky of radiance 1; Mitsuba's ``blendbsdf`` omits ideal lobes."""
    mirror = {"type": "twosided", "b": {"type": "conductor", "specular_reflectance": 0.7}}
    lamp = {"type": "rectangle", "to_world": T().translate([0, 0, -1]).scale(9), **area(2.0)}
    hole, card = {"type": "null"}, {"type": "diffuse", "reflectance": 0.4}
    pairs = {-1.6: (hole, card), -0.3: (mirror, card), -1.3: (hole, mirror)}
    for expected, (first, second) in pairs.items():
        integrator = {"type": "prosim", "diffuse_bounces": diffuse_bounces}
        blend = {"type": "blendbsdf", "weight": 0.6, "a": first, "b": second}
        scene = card_below_a_sky(blend, integrator=integrator, lamp=lamp)
        params = mi.traverse(scene)

        def mean(weight):
            params["card.bsdf.weight.value"] = weight  # noqa: B023 (called here)
            params.update()  # noqa: B023
            return dr.mean(mi.render(scene, params, spp=256), axis=None)  # noqa: B023

        assert derivative(mean, 0.6) == pytest.approx(expected, rel=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("around", [{}, {"type": "mask", "opacity": 0.6}, {"type": "twosided"}])
@pytest.mark.parametrize("name", ["diffuse_reflectance", "specular_reflectance", "eta"])
def test_the_choice_of_an_ideal_lobe_has_no_derivative(variant_rgb, around, name):
    """Of plastic, the derivative by kd was wrong by 7 %, and that by ks by 95 %; of thin glass, that by eta was 0."""
    bsdf = {"type": "plastic", "diffuse_reflectance": 0.5, "specular_reflectance": 0.7, "int_ior": 1.5}
    if name == "eta":
        bsdf = {"type": "thindielectric", "specular_reflectance": 0.3}
        around = {} if around.get("type") == "twosided" else around  # glass has both sides
    scene = card_below_a_sky(around | {"b": bsdf} if around else bsdf)
    key = next(key for key, _ in mi.traverse(scene) if name in key)

    def change(params, e):
        params[key] = type(params[key])(0.5 + e)

    expected = central_difference(
        scene, change, 0.05, lambda: weighted_mean(mi.render(scene, seed=2, spp=1024)).array[0]
    )
    forward, backward = derivatives(scene, change, spp=1024)
    assert backward == pytest.approx(expected, rel=0.01)
    assert weighted_mean(forward).array[0] == pytest.approx(backward, rel=1e-3)


ADAPTIVE = {"integrator": {"type": "prosim_adaptive", "nested": {"type": "prb"}}}
BY_TREE = {"integrator": {"type": "prosim"}}
GROUP = {"type": "shapegroup", "id": "group", "ball": {"type": "sphere"}}
INSTANCE = ADAPTIVE | {"group": GROUP, "there": {"type": "instance", "shapes": {"type": "ref", "id": "group"}}}
MAP = {"type": "bumpmap"}
ROUGH = {"type": "twosided", "b": {"type": "roughplastic", "alpha": 0.3}}
BLEND = {"type": "blendbsdf", "weight": 0.5, "a": {"type": "diffuse"}, "b": {"type": "conductor"}}
MASK = {"type": "mask", "opacity": 0.5, "b": {"type": "plastic"}}


@pytest.mark.slow
@pytest.mark.parametrize(
    "bsdf, right, wrong, words, others",
    [
        (ROUGH, "brdf_0.diffuse_reflectance.value", "brdf_0.alpha", "derivatives by alpha of", {}),
        (ROUGH, "brdf_0.diffuse_reflectance.value", "brdf_0.alpha", "derivatives by alpha of", ADAPTIVE),
        (MAP | {"b": BLEND}, "reflectance.value", "weight.value", "may be wrong", {}),
        (MAP | {"b": MASK}, "opacity.value", "diffuse_reflectance.value", "may be wrong", {}),
        ({"type": "principled"}, "base_color.value", "roughness.value", "diffuse_bounces = -1", BY_TREE),
        (ROUGH | {"b": {"type": "pplastic"}}, "eta.value", "alpha.value", "diffuse_bounces = -1", BY_TREE),
        ({"type": "principled", "sheen": 0.01}, "sheen.value", "clearcoat.value", "derivatives by clearcoat of", {}),
        ({"type": "principled"}, "roughness.value", None, "diffuse_bounces = -1", {}),  # here all rays are followed
        ({"type": "diffuse"}, "card.bsdf.reflectance.value", "there.to_world", "to_world of 'there'", INSTANCE),
    ],
)
def test_derivatives_that_mitsuba_lacks_cause_a_warning(variant_rgb, logged, bsdf, right, wrong, words, others):
    texture = {"texture": bitmap(np.ones((2, 2, 3)))} if bsdf["type"] == "bumpmap" else {}
    scene = card_below_a_sky(bsdf | texture, **others)
    for name, warned in ((right, False), (wrong, True))[: 2 if wrong else 1]:
        params = mi.traverse(scene)
        key = next(key for key, _ in params if key.endswith(name))
        dr.enable_grad(params[key])
        params.update()
        logged.clear()
        dr.backward(dr.mean(mi.render(scene, params, spp=1), axis=None))
        assert sum(words in text for _, text in logged) == warned


@pytest.mark.slow
@pytest.mark.parametrize("name, of_sun", [("turbidity", 0.1), ("turbidity", 0.0), ("sun_direction", 0.1)])
@pytest.mark.parametrize("settings", [TREE, PATH])
def test_derivatives_by_a_sunsky_match_differences(variant_rgb, settings, name, of_sun):
    """Reverse mode, within 3 %; those of a tree by the turbidity were too small by 70 %, those by the sun twice as
    great.
    """
    sky = {"type": "sunsky", "turbidity": 4.5, "sun_scale": of_sun, "sun_direction": [0.3, 0.8, 0.5]}
    scene = load_scene(
        integrator={"type": "prosim", "adaptive": "none", **settings},
        sensor=camera([0, 3, 4], [0, 0, 0], film(8, pixel_format="rgb", component_format="float32"), fov=20),
        sky=sky | {"to_world": T().rotate([1, 0, 0], -90)},
        floor=ground(4, diffuse(0.6, 0.6, 0.6)),
    )
    params, key, paths = mi.traverse(scene), f"sky.{name}", mi.load_dict({"type": "prosim", **PATH})
    value = type(params[key])(params[key])

    def mean(e, spp=1024, **ours):
        params[key] = value + e * (mi.Vector3f(0.3, 0, -0.2) if name == "sun_direction" else 1)
        params.update()
        return weighted_mean(mi.render(scene, params, seed=3, spp=spp, **ours))

    above, below = (mean(mi.Float(e), 4096, integrator=paths).array[0] for e in (0.05, -0.05))
    assert derivative(mean) == pytest.approx((above - below) / 0.1, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("diffuse_bounces", [0, -1])
def test_samples_that_glass_discards_have_no_derivative(variant_rgb, diffuse_bounces):
    """The image of a card, seen from behind, is proportional to the radiance of the sky. The noise is 0.2 %."""
    for glass in (
        {"type": "roughdielectric", "alpha": 0.4, "int_ior": 1.8},
        {"type": "principledthin", "diff_trans": 1.0, "spec_trans": 0.9, "roughness": 0.7, "eta": 1.4},
    ):
        integrator = {"type": "prosim", "diffuse_bounces": diffuse_bounces}
        scene = card_below_a_sky(glass, integrator=integrator, sensor=camera([0, 3, -4], [0, 0, 0], film(8), fov=10))
        params = mi.traverse(scene)
        dr.enable_grad(params["sky.radiance.value"])
        params.update()
        image = mi.render(scene, params, spp=2000)
        dr.forward(params["sky.radiance.value"])
        assert np.mean(dr.grad(image)) == pytest.approx(np.mean(image), rel=0.01)
