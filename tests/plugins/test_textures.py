import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from mitsuba_prosim.procedural.patterns import gradient_noise, square_wave
from scenes import load_scene
from scipy import integrate

PLUGINS = ("prosim_brick", "prosim_stripes", "prosim_fractal")
FEW_OCTAVES = {"prosim_fractal": {"octaves": 3}}  # each is compiled
COLORS = {
    "prosim_brick": ("mortar", "brick"),
    "prosim_stripes": ("color1", "color0"),
    "prosim_fractal": ("color0", "color1"),
}  # at pattern value 0, 1


def rgb(*value):
    return {"type": "rgb", "value": list(value)}


def texture(plugin, low=0.0, high=1.0, **parameters):
    names = COLORS[plugin]
    return mi.load_dict({"type": plugin, names[0]: low, names[1]: high, **parameters})


def at(uv, p=None):
    """A surface at the texture coordinates ``uv`` (2 x n), and at the points ``p`` (3 x n) of space."""
    si = dr.zeros(mi.SurfaceInteraction3f, len(np.array(uv)[0]))
    si.uv = mi.Point2f(np.array(uv, dtype=np.float32))
    if p is not None:
        si.p = mi.Point3f(np.array(p, dtype=np.float32))
    return si


def points(n, dimensions, seed=0, low=-3, high=3):
    return np.random.default_rng(seed).uniform(low, high, (dimensions, n))


def test_stripes(variant_rgb):
    stripes = texture("prosim_stripes", frequency=2.0, duty=0.25, axis=[0, 3, 0])
    v = np.array([0.0, 0.06, 0.065, 0.25, 0.43, 0.44, 0.5, -0.06, -0.07, 7.0])
    inside = [1, 1, 0, 0, 0, 1, 1, 1, 0, 1]
    assert np.allclose(stripes.eval_1(at([v * 0, v])), inside, atol=1e-3)
    assert np.allclose(stripes.eval_1(at([v, v * 0])), 1)


def test_stripes_across_a_slanted_axis(variant_rgb):
    stripes = texture("prosim_stripes", frequency=1.0, solid=True, axis=[1, 1, 1])
    along = points(100, 3)
    across = along - along.mean(axis=0) + 0.5 / np.sqrt(3)  # half a period from the origin
    assert np.allclose(stripes.eval_1(at(across[:2], across)), 0)
    assert np.allclose(stripes.eval_1(at(across[:2], across - 0.5 / np.sqrt(3))), 1)


def test_brick(variant_rgb):
    """Rows of 0.3 with joints of 0.1, centred on the origin; every other row is shifted by half a brick of 0.9 +
    0.1.
    """
    brick = texture("prosim_brick", brick_width=0.9, brick_height=0.3, mortar_width=0.1)
    x = [0.5, 0.5, 0.5, 0.5, 0.5, 0.04, 0.06, 0.94, 0.96, -0.04, 0.5, 0.0, 0.44, 0.46, 0.0, 0.5]
    y = [0.2, 0.04, 0.06, 0.34, 0.36, 0.2, 0.2, 0.2, 0.2, 0.2, 0.6, 0.6, 0.6, 0.6, -0.2, -0.2]
    inside = [1, 0, 1, 1, 0, 0, 1, 1, 0, 0, 0, 1, 1, 0, 1, 0]
    assert np.allclose(brick.eval_1(at([x, y])), inside, atol=1e-3)


def test_solid_brick(variant_rgb):
    """The same in three dimensions, centred on the middle of a brick."""
    brick = texture("prosim_brick", brick_width=0.9, brick_height=0.3, mortar_width=0.1, solid=True)
    x = [0, 0.44, 0.46, 0, 0, 0, 0, 0, 0.1]
    y = [0, 0, 0, 0.14, 0.16, 0, 0, 0.4, 0.4]
    z = [0, 0, 0, 0, 0, 0.44, 0.46, 0, 0]
    inside = [1, 1, 0, 1, 0, 1, 0, 0, 1]
    assert np.allclose(brick.eval_1(at([x, x], [x, y, z])), inside, atol=1e-3)


@pytest.mark.parametrize("solid", (False, True))
@pytest.mark.parametrize("plugin", PLUGINS)
def test_mean(variant_rgb, plugin, solid):
    """Against the average over 2^20 points in a large region; 4.5 standard errors of independent points (fractal: of
    its lattice cells).
    """
    whole = texture(plugin, solid=solid, low=0.1, high=0.7, **({"octaves": 3} if plugin == "prosim_fractal" else {}))
    p = points(1 << 20, 3, high=300)
    values = np.array(whole.eval_1(at(p[:2], p)))
    assert values.mean() == pytest.approx(np.array(whole.mean()).item(), abs=0.003)
    assert values.min() >= 0.1 - 1e-5 and values.max() <= 0.7 + 1e-5
    assert whole.max() == pytest.approx(0.7) and whole.is_spatially_varying()


@pytest.mark.parametrize("solid", (False, True))
@pytest.mark.parametrize("plugin", PLUGINS)
def test_scalar_agrees_with_vectorised(plugin, solid):
    p = points(40, 3, seed=5)
    mi.set_variant("llvm_ad_rgb")
    expected = np.array(texture(plugin, solid=solid).eval_1(at(p[:2], p)))
    mi.set_variant("scalar_rgb")
    pattern = texture(plugin, solid=solid)
    si = mi.SurfaceInteraction3f()
    si.dp_du, si.dp_dv, si.duv_dx, si.duv_dy = [0, 0, 0], [0, 0, 0], [0, 0], [0, 0]
    for column, value in zip(p.T, expected):
        si.uv, si.p = mi.Point2f(column[:2]), mi.Point3f(column)
        assert pattern.eval_1(si) == pytest.approx(value, abs=2e-3)


@pytest.mark.parametrize("plugin", PLUGINS)
def test_colours(variant, plugin):
    """The mixture of two colours, by every way to ask for it; a nested texture as colour."""
    names = COLORS[plugin]
    low, high = np.array([0.1, 0.2, 0.3]), np.array([0.9, 0.5, 0.2])
    colored = mi.load_dict({"type": plugin, names[0]: rgb(*low), names[1]: rgb(*high)})
    nested = mi.load_dict({"type": plugin, names[0]: 0.0, names[1]: {"type": plugin, names[0]: 0.0, names[1]: 1.0}})
    plain = texture(plugin)
    si = dr.zeros(mi.SurfaceInteraction3f) if variant != "scalar_rgb" else mi.SurfaceInteraction3f()
    si.dp_du, si.dp_dv, si.duv_dx, si.duv_dy = [mi.Vector3f(0)] * 2 + [mi.Vector2f(0)] * 2
    si.wavelengths = [450, 520, 580, 640] if variant == "llvm_ad_spectral" else []
    for uv in ((0.31, 0.27), (0.02, 0.44), (0.75, 0.8), (0.5, 0.13)):
        si.uv = mi.Point2f(uv)
        dr.make_opaque(si.uv)
        w = np.array(plain.eval_1(si)).item()
        if variant.endswith("rgb"):
            assert np.allclose(np.array(colored.eval(si)).ravel(), low + w * (high - low), atol=1e-5)
            assert np.allclose(np.array(colored.eval_3(si)).ravel(), low + w * (high - low), atol=1e-5)
        else:
            assert np.all(np.isfinite(np.array(colored.eval(si))))
        assert np.array(nested.eval_1(si)).item() == pytest.approx(w * w, abs=1e-5)


def test_square_wave_is_averaged_exactly(variant_rgb):
    """Over boxes of any width, against the average of 20000 points."""
    x = np.linspace(-1.3, 2.1, 37)
    for width in (0.01, 0.2, 0.77, 3.1):
        offsets = (np.arange(20_000) + 0.5) / 20_000 - 0.5
        y = x[:, None] + width * offsets
        expected = (np.abs(y - np.round(y)) <= 0.15).mean(axis=1)
        assert np.allclose(square_wave(mi.Float(x), mi.Float(0.3), mi.Float(width)), expected, atol=2e-4)
    assert np.allclose(square_wave(mi.Float(x), mi.Float(0.3), mi.Float(1e6)), 0.3, atol=1e-3)


@pytest.mark.parametrize("solid", (False, True))
@pytest.mark.parametrize("plugin", PLUGINS)
def test_footprint_and_smoothing(variant_rgb, plugin, solid):
    """A footprint known from ray differentials, or the parameter, lessens the contrast and keeps the mean; a huge one
    leaves the mean alone: no crawling.
    """
    p = points(20_000, 3, high=30)
    sharp = texture(plugin, solid=solid)
    reference = np.array(sharp.eval_1(at(p[:2], p)))
    deviations = [reference.std()]
    for size in (0.05, 30.0):
        si = at(p[:2], p)
        si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
        si.duv_dx, si.duv_dy = mi.Vector2f(size, 0), mi.Vector2f(0, size)
        dr.make_opaque(si.duv_dx, si.duv_dy)
        filtered = np.array(sharp.eval_1(si))
        smoothed = np.array(texture(plugin, solid=solid, smoothing=size).eval_1(at(p[:2], p)))
        if not solid:
            assert np.allclose(filtered, smoothed, atol=1e-4)
        assert filtered.mean() == pytest.approx(reference.mean(), abs=0.02)
        deviations.append(smoothed.std())
    assert deviations[0] > 1.02 * deviations[1] and deviations[2] < 0.01


@pytest.mark.parametrize("plugin", PLUGINS)
def test_to_local(variant_rgb, plugin):
    p = points(500, 3)
    moved = texture(plugin, solid=True, to_local=mi.ScalarTransform4f().translate([1, 2, 3]).scale(2))
    expected = texture(plugin, solid=True).eval_1(at(p[:2], 2 * p + np.array([[1], [2], [3]])))
    assert np.allclose(moved.eval_1(at(p[:2], p)), expected, atol=1e-3)


def test_noise(variant_rgb):
    """Zero on the lattice, continuous with its derivative across cells, symmetric about 0, decorrelated by key and by
    distance: 5 standard errors of 100 000 nearly independent values.
    """
    for dimensions, deviation in ((2, 0.177), (3, 0.191)):
        x = [mi.Float(v) for v in points(100_000, dimensions, high=1000)]
        values = np.array(gradient_noise(x, mi.UInt32(1)))
        assert values.std() == pytest.approx(deviation, rel=0.02)
        assert abs(values.mean()) < 5 * deviation / np.sqrt(1e5)
        for other in (gradient_noise(x, mi.UInt32(2)), gradient_noise([v + 7.3 for v in x], mi.UInt32(1))):
            assert abs(np.corrcoef(values, np.array(other))[0, 1]) < 5 / np.sqrt(1e5)
        assert dr.all(gradient_noise([dr.floor(v) for v in x], mi.UInt32(1)) == 0)
        h = 1e-3
        below, above = ([dr.floor(x[0]) + side * h, *x[1:]] for side in (-1, 1))
        left, right = gradient_noise(below, mi.UInt32(1)), gradient_noise(above, mi.UInt32(1))
        middle = gradient_noise([dr.floor(x[0]), *x[1:]], mi.UInt32(1))
        assert dr.max(dr.abs(left + right - 2 * middle))[0] < 1e-3  # a jump of the slope by 1 would leave 1e-3 * 2


@pytest.mark.parametrize("plugin", PLUGINS)
def test_gradient_for_bump_maps(variant_rgb, plugin):
    """The flux of the gradient: its integral along a line is the difference of the ends."""
    smooth = texture(plugin, smoothing=0.1)
    u = np.linspace(0.11, 0.62, 2001)
    slope = np.array(smooth.eval_1_grad(at([u, u * 0 + 0.3])))
    ends = np.array(smooth.eval_1(at([u[[0, -1]], [0.3, 0.3]])))
    assert integrate.trapezoid(slope[0], u) == pytest.approx(ends[1] - ends[0], abs=2e-3)
    loaded = mi.load_dict({"type": "bumpmap", "nested": smooth, "bsdf": {"type": "diffuse"}})
    assert "bump" in str(loaded).lower()


def image(plugin, integrator="path", **parameters):
    low, high = COLORS[plugin]
    reflectance = {"type": plugin, low: rgb(0.2, 0.3, 0.4), high: rgb(0.8, 0.7, 0.6)} | parameters
    place = mi.ScalarTransform4f().look_at([0, -3, 2], [0, 0, 0], [0, 0, 1])
    film = {"type": "hdrfilm", "width": 8, "height": 8}
    scene = load_scene(
        integrator={"type": integrator, "max_depth": 2},
        light={"type": "constant"},
        sensor={"type": "perspective", "to_world": place, "film": film},
        ball={"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": reflectance}},
    )
    return scene, mi.traverse(scene)


@pytest.mark.slow
@pytest.mark.parametrize("plugin", PLUGINS)
def test_derivatives_of_colours(variant_rgb, plugin):
    """Through prb; the image is linear in them. The two seeds differ: 5 % is five times the noise."""
    scene, params = image(plugin, "prb", **FEW_OCTAVES.get(plugin, {}))
    for color in COLORS[plugin]:
        key = f"ball.bsdf.reflectance.{color}.value"
        start = mi.Color3f(params[key])

        def mean(shift, key=key, start=start):
            params[key] = start + shift
            params.update()
            return dr.mean(mi.render(scene, params, spp=512, seed=3, seed_grad=4).array)

        low, high = mean(-0.1)[0], mean(0.1)[0]
        x = mi.Float(0)
        dr.enable_grad(x)
        dr.backward(mean(x))
        assert high > low
        assert dr.grad(x)[0] == pytest.approx((high - low) / 0.2, rel=0.05)
        mean(0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "plugin, name",
    (
        *(("prosim_brick", name) for name in ("brick_width", "brick_height", "mortar_width", "smoothing")),
        *(("prosim_stripes", name) for name in ("frequency", "duty", "axis", "smoothing")),
        *(("prosim_fractal", name) for name in ("scale", "gain", "lacunarity", "smoothing")),
    ),
)
def test_derivatives_of_numbers(variant_rgb, plugin, name):
    """Of a weighted mean over a region, against central differences; with edges soft enough to have a derivative, but
    joints not filled, for the step from one row of bricks to the next has none.
    """
    smoothing = 0.008 if plugin == "prosim_brick" else 0.05
    pattern = texture(plugin, smoothing=smoothing, solid=True, **FEW_OCTAVES.get(plugin, {}))
    params = mi.traverse(pattern)
    p = points(1_000_000, 3, high=0.2, low=0)
    weight = mi.Float(25 * p[0] * p[1])
    start = type(params[name])(params[name])
    step = 1e-4

    def mean(shift):
        params[name] = start + mi.Vector3f(0, shift, 0) if name == "axis" else start + shift
        params.update()
        dr.make_opaque(params[name])
        return weight * dr.square(pattern.eval_1(at(p[:2], p)))

    low, high = (np.array(mean(shift), dtype=np.float64).mean() for shift in (-step, step))
    x = mi.Float(0)
    dr.enable_grad(x)
    dr.backward(dr.mean(mean(x)))
    assert abs(dr.grad(x)[0]) > 1e-3
    assert dr.grad(x)[0] == pytest.approx((high - low) / (2 * step), rel=0.05)


def test_product(variant):
    product = mi.load_dict(
        {
            "type": "prosim_product",
            "a": {"type": "prosim_stripes", "color0": 0.3, "color1": 0.8},
            "b": {"type": "prosim_stripes", "color0": 0.5, "color1": 0.2},
        }
    )
    si = dr.zeros(mi.SurfaceInteraction3f) if variant != "scalar_rgb" else mi.SurfaceInteraction3f()
    si.wavelengths = [450, 520, 580, 640] if variant == "llvm_ad_spectral" else []
    si.duv_dx, si.duv_dy = mi.Vector2f(0), mi.Vector2f(0)
    for uv, expected in (((0.2, 0.3), 0.15), ((0.3, 0.3), 0.16)):
        si.uv = mi.Point2f(uv)
        assert np.allclose(np.array(product.eval_1(si)), expected)
        assert np.allclose(np.array(product.eval(si)), expected, atol=1e-5)
    assert np.array(product.mean()).item() == pytest.approx(0.55 * 0.35)
    assert product.is_spatially_varying()
    assert min(mi.traverse(product).keys()).startswith("a.")


@pytest.mark.parametrize(
    "plugin, parameter, value",
    (
        ("prosim_brick", "brick_width", 0.0),
        ("prosim_brick", "brick_height", -1.0),
        ("prosim_brick", "mortar_width", -0.1),
        ("prosim_brick", "smoothing", -1.0),
        ("prosim_stripes", "frequency", 0.0),
        ("prosim_stripes", "duty", 1.5),
        ("prosim_stripes", "axis", [0, 0, 1]),
        ("prosim_fractal", "scale", 0.0),
        ("prosim_fractal", "octaves", 0),
        ("prosim_fractal", "octaves", 17),
        ("prosim_fractal", "octaves", 2.5),
        ("prosim_fractal", "gain", -1.0),
        ("prosim_fractal", "lacunarity", 0.0),
        ("prosim_fractal", "seed", -1),
    ),
)
def test_errors(variant_rgb, plugin, parameter, value):
    with pytest.raises(Exception, match=f'{plugin}.*parameter "{parameter}" is .*; allowed: '):
        mi.load_dict({"type": plugin, parameter: value})
