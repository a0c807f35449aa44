"""Fresnel's equations near their limits, the approximation of the thesis, and the losses that the page states."""

import re
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from drawing import curves
from mitsuba_prosim.optics import fresnel


def test_fresnel_is_precise_for_indices_near_1(variant_rgb):
    """Against amplitudes in double precision, from both sides; not next to the critical angle."""
    cos = np.linspace(0.001, 1, 1000, dtype=np.float32).astype(float)
    for eta in np.float32([1 + 1e-2, 1 - 1e-3, 1 + 1e-5]).astype(float):
        for side, index in ((1, eta), (-1, 1 / eta)):
            t2 = 1 - (1 - cos**2) / index**2
            t, apart = np.sqrt(t2 + 0j), np.abs(t2) > 1e-3
            s, p = (cos - index * t) / (cos + index * t), (index * cos - t) / (index * cos + t)
            found = np.array(fresnel.interface(mi.Float(side * cos), mi.Float(eta)).f, dtype=float)
            expected = 0.5 * (abs(s) ** 2 + abs(p) ** 2)
            np.testing.assert_allclose(found[apart], expected[apart], rtol=2e-4, atol=1e-12)


def test_the_approximation_of_the_thesis_holds_for_a_large_index(variant_rgb):
    cos = mi.Float(np.cos(np.radians(np.linspace(0, 89, 90))))

    def difference(eta, k):
        args = cos, mi.Color3f(eta), mi.Color3f(k)
        return dr.max(dr.abs(fresnel.conductor(*args) - fresnel.conductor_thesis(*args)), axis=None)

    assert difference(1.5, 7.5) < 5e-3  # aluminium: good
    assert difference(0.2, 3.9) < 1e-2
    assert difference(0.5, 0.5) > 5e-2  # n² + k² is not large: bad


@pytest.mark.slow
def test_the_documented_losses_are_measured(variant_rgb):
    """docs/optics.md has a table of the light lost in cavities, in per cent, and a sentence for a glass."""
    text = (Path(__file__).parents[2] / "docs" / "optics.md").read_text()
    rows = [line.strip("| \n").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    metals = [r for r in rows if len(r) == 7 and r[0] not in ("m", "---")]
    assert len(metals) == 4
    for width, *losses in metals:
        mirror = mi.load_dict({"type": "prosim_conductor", "alpha": float(width)})
        for angle, loss in zip((0, 30, 45, 60, 75, 85), losses, strict=True):
            assert 100 * (1 - curves.albedo(mirror, angle, float(width))[0][0]) == pytest.approx(float(loss), abs=0.15)
    (sentence,) = re.findall(r"A rough glass of index 1\.5 with m = 0\.6 loses .*?inside", text, re.DOTALL)
    glass = mi.load_dict({"type": "prosim_dielectric", "int_ior": 1.5, "ext_ior": 1.0, "alpha": 0.6})
    for angle, loss in zip((0, 60, 180, 120), re.findall(r"([\d.]+) %", sentence), strict=True):
        back, on = curves.albedo(glass, angle, 0.6, 1.5)
        assert 100 * (1 - (back + on)[0]) == pytest.approx(float(loss), abs=0.15)
