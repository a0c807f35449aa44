import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from mitsuba_prosim.procedural.patterns import gradient_noise, square_wave
from scenes import rgb

#: name -> names of the colours at pattern value 0 and 1.
BRICK, STRIPES, FRACTAL = "prosim_brick", "prosim_stripes", "prosim_fractal"
COLORS = {BRICK: ("mortar", "brick"), STRIPES: ("color1", "color0"), FRACTAL: ("color0", "color1")}
FEW_OCTAVES = {FRACTAL: {"octaves": 3}}  # each is compiled

each = pytest.mark.parametrize("plugin", COLORS)
flat_and_solid = pytest.mark.parametrize("solid", (False, True))


def texture(plugin, low=0.0, high=1.0, **parameters):
    names = COLORS[plugin]
    return mi.load_dict({"type": plugin, names[0]: low, names[1]: high, **parameters})


def surface():
    """A surface in any variant, seen without ray differentials."""
    si = mi.SurfaceInteraction3f() if mi.variant() == "scalar_rgb" else dr.zeros(mi.SurfaceInteraction3f)
    si.dp_du = si.dp_dv = mi.Vector3f(0)
    si.duv_dx = si.duv_dy = mi.Vector2f(0)
    si.wavelengths = [450, 520, 580, 640] if mi.is_spectral else []
    return si


def at(uv, p=None):
    """A surface at the texture coordinates ``uv`` (2 x n), and at the points ``p`` (3 x n) of space."""
    si = dr.zeros(mi.SurfaceInteraction3f, len(np.array(uv)[0]))
    si.uv = mi.Point2f(np.array(uv, dtype=np.float32))
    if p is not None:
        si.p = mi.Point3f(np.array(p, dtype=np.float32))
    return si


def points(n, dimensions, seed=0, low=-3, high=3):
    return np.random.default_rng(seed).uniform(low, high, (dimensions, n))


def test_stripes_are_where_their_parameters_say(variant_rgb):
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


def test_bricks_are_where_their_parameters_say(variant_rgb):
    """Rows of 0.3 with joints of 0.1, centred on the origin; every other row is shifted by half a brick of 0.9 +
    0.1.
    """
    brick = texture("prosim_brick", brick_width=0.9, brick_height=0.3, mortar_width=0.1)
    x = [0.5, 0.5, 0.5, 0.5, 0.5, 0.04, 0.06, 0.94, 0.96, -0.04, 0.5, 0.0, 0.44, 0.46, 0.0, 0.5]
    y = [0.2, 0.04, 0.06, 0.34, 0.36, 0.2, 0.2, 0.2, 0.2, 0.2, 0.6, 0.6, 0.6, 0.6, -0.2, -0.2]
    inside = [1, 0, 1, 1, 0, 0, 1, 1, 0, 0, 0, 1, 1, 0, 1, 0]
    assert np.allclose(brick.eval_1(at([x, y])), inside, atol=1e-3)


def test_solid_bricks_are_where_their_parameters_say(variant_rgb):
    """The same in three dimensions, centred on the middle of a brick."""
    brick = texture("prosim_brick", brick_width=0.9, brick_height=0.3, mortar_width=0.1, solid=True)
    x = [0, 0.44, 0.46, 0, 0, 0, 0, 0, 0.1]
    y = [0, 0, 0, 0.14, 0.16, 0, 0, 0.4, 0.4]
    z = [0, 0, 0, 0, 0, 0.44, 0.46, 0, 0]
    inside = [1, 1, 0, 1, 0, 1, 0, 0, 1]
    assert np.allclose(brick.eval_1(at([x, x], [x, y, z])), inside, atol=1e-3)


@flat_and_solid
@each
def test_mean_is_the_average_of_many_points(variant_rgb, plugin, solid):
    """2^20 points in a large region; 4.5 standard errors of independent points (fractal: of its lattice cells)."""
    whole = texture(plugin, solid=solid, low=0.1, high=0.7, **FEW_OCTAVES.get(plugin, {}))
    p = points(1 << 20, 3, high=300)
    values = np.array(whole.eval_1(at(p[:2], p)))
    assert values.mean() == pytest.approx(np.array(whole.mean()).item(), abs=0.003)
    assert values.min() >= 0.1 - 1e-5 and values.max() <= 0.7 + 1e-5
    assert whole.max() == pytest.approx(0.7) and whole.is_spatially_varying()


@each
def test_a_pattern_mixes_two_colours_or_textures(variant, plugin):
    """By every way to ask for it."""
    names = COLORS[plugin]
    low, high = np.array([0.1, 0.2, 0.3]), np.array([0.9, 0.5, 0.2])
    colored = mi.load_dict({"type": plugin, names[0]: rgb(*low), names[1]: rgb(*high)})
    nested = mi.load_dict({"type": plugin, names[0]: 0.0, names[1]: {"type": plugin, names[0]: 0.0, names[1]: 1.0}})
    plain, si = texture(plugin), surface()
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


@flat_and_solid
@each
def test_footprint_and_smoothing_lessen_the_contrast_and_keep_the_mean(variant_rgb, plugin, solid):
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


@each
def test_to_local_transforms_the_points(variant_rgb, plugin):
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


def test_a_product_multiplies_two_textures(variant):
    a, b = ({"type": STRIPES, "color0": first, "color1": other} for first, other in ((0.3, 0.8), (0.5, 0.2)))
    product, si = mi.load_dict({"type": "prosim_product", "a": a, "b": b}), surface()
    for uv, expected in (((0.2, 0.3), 0.15), ((0.3, 0.3), 0.16)):
        si.uv = mi.Point2f(uv)
        assert np.allclose(np.array(product.eval_1(si)), expected)
        assert np.allclose(np.array(product.eval(si)), expected, atol=1e-5)
    assert np.array(product.mean()).item() == pytest.approx(0.55 * 0.35)
    assert product.is_spatially_varying()
    assert min(mi.traverse(product).keys()).startswith("a.")
