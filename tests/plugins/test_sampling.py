"""N-rook sampling (thesis, sections 4.2.1.2 and 5.3.2): exact properties of the patterns, and their statistics."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scipy
from mitsuba_prosim.sampling.hash import hash32
from mitsuba_prosim.sampling.nrook import NRook, Permutations, pixel_key
from mitsuba_prosim.sampling.sobol import Sobol
from scenes import T, area, film, load_scene, rectangle


def pattern(n, pixels, space=3, seed=7, jitter="multi"):
    """All N² samples of many pixels: an array (pixels, passes, samples of a pass, 2)."""
    lane = dr.arange(mi.UInt32, pixels * n * n)
    t, pixel = lane % (n * n), lane // (n * n)
    points = NRook(Permutations(n), pixel_key(seed, pixel), t, jitter)(space)
    return np.array(points).T.reshape(pixels, n, n, 2)


@pytest.mark.parametrize("jitter", ["multi", "uniform"])
@pytest.mark.parametrize("n", [1, 2, 5, 16])
def test_passes_are_nrook_patterns_that_fill_all_cells(variant_rgb, n, jitter):
    points = pattern(n, 50, jitter=jitter)
    assert points.min() >= 0 and points.max() < 1
    cells = np.floor(points * n).astype(int)
    assert np.all(np.sort(cells, axis=2) == np.arange(n)[:, None])  # each pass: one sample a row, one a column
    index = (cells[..., 0] * n + cells[..., 1]).reshape(50, -1)
    assert np.all(np.sort(index, axis=1) == np.arange(n * n))  # after N rotations: every cell once


def test_multi_jitter_fills_all_strata_of_each_axis(variant_rgb):
    """Kensler 2013: the place within a row's strata depends on the column alone, and the other way round."""
    points = pattern(5, 50).reshape(50, 25, 2)
    assert np.all(np.sort(np.floor(points * 25).astype(int), axis=1) == np.arange(25)[:, None])
    cell, place = np.floor(points * 5).astype(int), np.floor(points * 25).astype(int) % 5
    for axis in (0, 1):
        pairs = cell[..., 1 - axis] * 5 + place[..., axis]
        assert all(len(np.unique(p)) == 5 for p in pairs)


def test_columns_turn_by_one(variant_rgb):
    """Figure 5.11: in each row the column moves by one from pass to pass."""
    cells = np.floor(pattern(5, 20) * 5).astype(int)
    by_row = np.take_along_axis(cells[..., 1], np.argsort(cells[..., 0], axis=2), axis=2)
    assert np.all((by_row[:, 1:] - by_row[:, :-1]) % 5 == 1)


@pytest.mark.parametrize("n", [3, 5, 8])
def test_variance_of_one_pass(variant_rgb, n):
    """f = x + y has variance 1/(6 N³) in the thesis's pattern; f = (x-½)(y-½) gains next to nothing: 1/(144 (N-1)).

    The sample variance of 40000 pixels lies within 4 standard errors (two-sided significance 6e-5).
    """
    one_pass = pattern(n, 40000, jitter="uniform")[:, 0]
    for f, expected in ((one_pass.sum(2), 1 / (6 * n**3)), (np.prod(one_pass - 0.5, axis=2), 1 / (144 * (n - 1)))):
        mean = f.mean(1)
        square = (mean - mean.mean()) ** 2
        # The second value is asymptotic in N: allow its remainder, of relative order 1/N².
        slack = 0 if expected == 1 / (6 * n**3) else expected / n**2
        assert abs(square.mean() - expected) < 4 * square.std() / np.sqrt(len(square)) + slack


@pytest.mark.slow
def test_permutations_are_equally_likely(variant_rgb):
    """Chi² at significance 0.001: all 120 permutations of 5; each place of each element of 9."""
    h = hash32(dr.arange(mi.UInt32, 240000))
    five = Permutations(5)
    code = sum(np.array(five(h, mi.UInt32(i))).astype(int) * 5**i for i in range(4))
    counts = np.unique(code, return_counts=True)[1]
    assert len(counts) == 120 and scipy.stats.chisquare(counts).pvalue > 0.001
    nine = Permutations(9)
    for i in range(9):
        assert scipy.stats.chisquare(np.bincount(np.array(nine(h, mi.UInt32(i))))).pvalue > 0.001


@pytest.mark.slow
def test_keys_of_two_seeds_are_no_stream_shifted(variant_rgb):
    """Wherever a key of one seed is one of another's too, the next pixels' are not; under one seed all differ."""
    pixel = np.arange(1 << 18, dtype=np.uint64)

    def keys(seed):
        return np.array(pixel_key(mi.UInt32(seed), mi.UInt32(pixel)))

    a, b = keys(6058), keys(7452)
    assert len(np.unique(a)) == len(np.unique(b)) == len(pixel)
    _, i, j = np.intersect1d(a, b, assume_unique=True, return_indices=True)
    assert scipy.stats.poisson.sf(len(i) - 1, len(pixel) ** 2 / 2.0**32) > 1e-3  # as many as chance has it
    apart = np.unique((j.astype(np.int64) - i), return_counts=True)[1]
    assert apart.max() <= 2  # nor in the same order


# ------------------------------------------------------------------ points without end


def endless(n, pixels, space=3, seed=7):
    """The first ``n`` Sobol' points of many pixels: an array (pixels, n, 2)."""
    lane = dr.arange(mi.UInt32, pixels * n)
    return np.array(Sobol(pixel_key(seed, lane // n), lane % n)(space)).T.reshape(pixels, n, 2)


def test_two_to_the_k_endless_points_have_one_in_each_of_as_many_rectangles(variant_rgb):
    """Of any shape, for any 2^k >= 8 that begin at a multiple of it, and for the first and second 1, 2 and 4."""
    points = endless(256, 100)
    assert points.min() >= 0 and points.max() < 1
    for k in range(9):
        some = points[:, : 2 * 2**k if k < 3 else 256].reshape(-1, 2**k, 2)
        for across in range(k + 1):
            cells = np.floor(some * [2**across, 2 ** (k - across)]).astype(int) @ [2 ** (k - across), 1]
            assert np.all(np.sort(cells, axis=1) == np.arange(2**k))


def test_endless_points_of_two_spaces_are_paired_by_chance(variant_rgb):
    """The variance of the mean of 64 products, one factor from each space, is about that of independent samples: 1.14
    times, and 1.57 times if each space had the same order within its blocks. Significance: below 1e-6.
    """
    one, other = (endless(64, 20000, space=space) - 0.5 for space in (3, 4))
    for axis in (0, 1):
        assert np.var(12 * (one[..., 0] * other[..., axis]).mean(axis=1)) * 64 < 1.3


@pytest.mark.parametrize("sequence, t", [*(("nrook", t) for t in (0, 6, 15)), ("sobol", 0), ("sobol", 7)])
def test_samples_are_uniform_and_spaces_pixels_and_seeds_independent(variant_rgb, sequence, t):
    """Of the ``t``-th samples of many pixels, so that passes may be cut short: Kolmogorov's test, Pearson's
    correlations, and chi² of the cells in two spaces, each at significance 0.001.
    """

    def samples(**how):
        points = pattern(4, 20000, **how) if sequence == "nrook" else endless(16, 20000, **how)
        return points.reshape(20000, 16, 2)[:, t]

    one, other, seed = samples(), samples(space=4), samples(seed=8)
    for axis in (0, 1):
        assert scipy.stats.kstest(one[:, axis], "uniform").pvalue > 0.001
        for others in (other, seed, np.roll(one, 1, axis=0)):
            assert scipy.stats.pearsonr(one[:, axis], others[:, axis]).pvalue > 0.001
    assert scipy.stats.pearsonr(*one.T).pvalue > 0.001
    cells = [np.floor(points * 4).astype(int) @ [4, 1] for points in (one, other)]
    assert scipy.stats.chi2_contingency(scipy.stats.contingency.crosstab(*cells).count).pvalue > 0.001


def test_scalar_samples_are_those_of_the_vectorised_variants():
    mi.set_variant("llvm_ad_rgb")
    nrook, sobol = pattern(5, 3).reshape(3, 25, 2), endless(25, 3)
    mi.set_variant("scalar_rgb")
    permutations = Permutations(5)
    for pixel, t in ((0, 0), (1, 17), (2, 24)):
        key = pixel_key(7, pixel)
        for points, expected in ((NRook(permutations, key, t), nrook), (Sobol(key, t), sobol)):
            assert np.allclose(np.array(points(3)), expected[pixel, t], atol=1e-7)


# ------------------------------------------------------------------ the sampler plugins


@pytest.mark.parametrize("plugin, n", [("nrook", 3), ("owen", 4)])
def test_samplers_take_these_points_in_any_variant(variant, plugin, n):
    sampler = mi.load_dict({"type": plugin, "sample_count": n * n})
    assert sampler.sample_count() == n * n
    if variant == "scalar_rgb":
        sampler.seed(5)
        points = []
        for _ in range(n * n):
            sampler.next_1d()
            points.append(np.array(sampler.next_2d()))
            sampler.advance()
        points = np.array(points)[None]
    else:
        sampler.set_samples_per_wavefront(n * n)
        sampler.seed(5, n * n * 10)
        sampler.next_1d()
        points = np.array(sampler.next_2d()).T.reshape(10, n * n, 2)
    cells = np.sort(np.floor(points * n).astype(int) @ [n, 1], axis=1)
    assert np.all(cells == np.arange(n * n))
    assert np.all(np.sort(np.floor(points * n * n).astype(int), axis=1) == np.arange(n * n)[:, None])


def test_sampler_and_clone_continue_after_a_wavefront(variant_rgb):

    def take(per_wavefront):
        sampler = mi.load_dict({"type": "nrook", "sample_count": 16})
        sampler.set_samples_per_wavefront(per_wavefront)
        sampler.seed(3, per_wavefront)
        points = []
        for _ in range(16 // per_wavefront):
            clone = sampler.clone()
            points.append(np.array(sampler.next_2d()).T)
            assert np.array_equal(points[-1], np.array(clone.next_2d()).T)
            sampler.advance()
        return np.concatenate(points)

    assert np.array_equal(take(16), take(4))


@pytest.mark.parametrize("integrator", ["direct", "prb"])
def test_sampler_stratifies_for_integrators_in_cpp_and_in_python(variant_rgb, integrator):
    """A vertical edge cuts the pixels of a column: 10 x 10 strata leave each an error below 1/100."""
    sampler = {"type": "nrook", "sample_count": 100}
    scene = load_scene(
        integrator={"type": integrator},
        sensor={"type": "orthographic", "sampler": sampler, "film": film(8, 64, pixel_format="luminance")},
        edge=rectangle(T().translate([1.1, 0, 2]).scale([1, 10, 1]), flip_normals=True, **area()),
    )
    image = np.array(mi.render(scene))[:, :, 0]
    cut = np.flatnonzero((image.mean(axis=0) > 0.01) & (image.mean(axis=0) < 0.99))
    assert len(cut) == 1
    assert np.ptp(image[:, cut]) < 0.02


def test_sampler_repeats_no_samples_in_several_passes_of_integrators_in_cpp(variant_rgb):
    sampler = mi.load_dict({"type": "nrook", "sample_count": 16})
    sampler.seed(mi.UInt32(3), 160)  # as with samples_per_pass = 4: each of 40 pixels has 4 lanes
    points = []
    for _ in range(4):
        points.append(np.array(sampler.clone().next_2d()).T)
        sampler.advance()
    assert len(np.unique(np.concatenate(points), axis=0)) == 4 * 160
