"""The number of samples that a user gives is the number that each pixel gets."""

import mitsuba as mi
import mitsuba_prosim
import numpy as np
import pytest
from mitsuba_prosim import denoising
from running import LIT_FLOOR, done, refused, scene_text

SPP = 12

CROP = '<integer name="crop_offset_x" value="3"/><integer name="crop_width" value="5"/>'
#: Policy of the scene and, if there are any, its limits.
POLICIES = {
    "neighbours": "",
    "graded": '<float name="noise" value="0.01"/>',
    "thesis": "",
    "none": '<float name="time" value="0.01"/><integer name="max_samples" value="5"/>',
}
INTEGRATORS = [
    '<integrator type="path"/>',
    *(
        f'<integrator type="{plugin}"><string name="adaptive" value="{policy}"/>{limits}{nested}</integrator>'
        for plugin, nested in (("prosim", ""), ("prosim_adaptive", '<integrator type="path"/>'))
        for policy, limits in POLICIES.items()
    ),
]


def by_command(path):
    done("render", path, "--spp", SPP)


def by_mitsuba(path):
    mi.render(mi.load_file(str(path)), spp=SPP)


def by_denoiser(path):
    pytest.importorskip("mitsuba_oidn")
    denoising.render(mi.load_file(str(path)), spp=SPP)


def by_notebook(path):
    pytest.importorskip("IPython")
    mitsuba_prosim.show(path, spp=SPP)


#: Numbers of integrators, and the way to render; the first is Mitsuba's own.
WAYS = [*zip(range(9), [by_command] * 9), *zip(range(1, 9), [by_mitsuba] * 8)]
WAYS += [(k, way) for k in (0, 2, 8) for way in (by_denoiser, by_notebook)]


@pytest.mark.parametrize("k, way", WAYS)
def test_each_pixel_gets_the_samples(scene, variant_rgb, counts, k, way):
    integrator, crop = INTEGRATORS[k], ("", CROP)[k % 2]
    scene.write_text(scene_text(integrator, LIT_FLOOR, sampler="independent").replace("<integer", crop + "<integer", 1))
    way(scene)
    assert np.all(counts() == SPP)


@pytest.mark.slow
def test_scene_in_the_language_gets_the_samples(palito, counts):
    done("render", palito, "--spp", SPP, "--resolution", "16x12", "--checkpoint")
    assert np.all(counts() == SPP)


def test_continued_render_keeps_its_samples_until_another_target_is_set(denoiser, scene, counts):
    scene.write_text(scene_text(INTEGRATORS[2], LIT_FLOOR))
    done("render", scene, "--spp", SPP, "--checkpoint", "--denoise")
    state = scene.with_suffix(".state.npz")
    assert np.all(counts() == SPP)
    assert "finished before" in done("resume", state).stdout
    assert "of 0.001" in done("resume", state, "--noise", 0.001).stdout


@pytest.mark.parametrize("sampler, spp, taken", [("stratified", 12, 16), ("multijitter", 7, 8), ("ldsampler", 9, 16)])
def test_rounding_sampler_is_refused(scene, sampler, spp, taken):
    scene.write_text(scene_text(sampler=sampler))
    refused(f"can't get exactly {spp} samples (--spp, in Python spp)", "render", scene, "--spp", spp)
    done("render", scene, "--spp", taken)


def test_odd_number_is_not_denoised(denoiser, scene):
    scene.write_text(scene_text(INTEGRATORS[1]))
    refused("a denoised image has two halves; take 14", "render", scene, "--spp", 13, "--denoise")
