"""Tests of a texture or a spectrum."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..inputs import rows, slopes, surface, uniform
from ..tests import Tests

#: Number of places.
INPUTS = 2**14


def at(uv: Any, wavelengths: Any = None) -> Any:
    """Points of a surface at ``uv``."""
    uv = mi.Point2f(uv)
    return surface((0, 0, 1), uv, dr.width(uv), wavelengths)


def colours(texture: Any, uv: np.ndarray) -> np.ndarray:
    """eval() at places, shape (channels, n)."""
    return rows(texture.eval(at(uv)), uv.shape[1])


def nearest(found: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Mean or luminance of colours, whichever is nearer to ``found``, because a plugin may return either."""
    means = [value.mean(axis=0), mi.luminance(mi.Color3f(value)) if len(value) == 3 else value[0]]
    return np.choose(np.argmin([np.abs(found - np.array(mean)) for mean in means], axis=0), means)


class Texture(Tests):
    """Tests of a texture or a spectrum: it is either a reflectance or light."""

    LIGHT, SMOOTH = (False, True), ("eval()",)

    def test_eval_1(self, texture: Any) -> None:
        """eval_1() is eval() where it is grey, and its luminance elsewhere."""
        uv = uniform(INPUTS, 2)
        value = colours(texture, uv)
        self.report.require("eval() is finite", np.isfinite(value), {"uv": uv})
        one = rows(texture.eval_1(at(uv)), INPUTS)[0]
        self.report.equal("eval_1() = eval()", one, nearest(one, value), {"uv": uv})

    def test_eval_3(self, texture: Any) -> None:
        """eval_3() is eval()."""
        uv = uniform(INPUTS, 2)
        if "rgb" in (mi.variant() or ""):
            self.report.equal("eval_3() = eval()", texture.eval_3(at(uv)), colours(texture, uv), {"uv": uv})

    def test_gradient(self, texture: Any) -> None:
        """eval_1_grad() is the difference of eval_1() between near places."""
        uv, found = uniform(INPUTS, 2, 2), texture.eval_1_grad(at(uniform(INPUTS, 2, 2)))
        difference = np.concatenate(slopes(lambda places: texture.eval_1(at(places)), uv, 3e-4))
        self.report.equal("eval_1_grad() = differences", found, difference, {"uv": uv}, (0.05, 0.05), share=0.25)

    def test_mean(self, texture: Any) -> None:
        """mean() is the mean of eval(); a texture that varies with uv says so."""
        value = self.grid(texture)
        varies = np.ptp(value, axis=1).max() > 1e-4
        says = texture.is_spatially_varying() or not varies
        self.report.require("is_spatially_varying() is true where uv matters", [says])
        if "rgb" in (mi.variant() or "") and "to_uv" not in self.subject.props:
            found = rows(texture.mean())[0]
            expected = nearest(found, value.mean(axis=1, keepdims=True))
            self.report.equal("mean() = the mean of eval()", found, expected, tolerance=(0.02, 0.01))

    def test_max(self, texture: Any) -> None:
        """max() is not below eval()."""
        most = rows(texture.max()).max() * 1.001 + 1e-6
        self.report.require("max() is not below eval()", [self.grid(texture).max() <= most])

    def grid(self, texture: Any, side: int = 512) -> np.ndarray:
        """eval() at a jittered grid of the unit square."""
        cells = np.indices((side, side)).reshape(2, -1) + uniform(side * side, 2, 3)
        return colours(texture, (cells / side).astype(np.float32))

    def test_positions(self, texture: Any) -> None:
        """Places of sample_position() have the density of pdf_position()."""
        uv, pdf = texture.sample_position(mi.Point2f(uniform(INPUTS, 2, 5)))
        self.report.equal("pdf of a place = pdf_position()", pdf, texture.pdf_position(uv))
        self.report.density(
            "samples follow pdf_position()",
            lambda u: texture.sample_position(u)[0],
            lambda p: texture.pdf_position(mi.Point2f(p)),
            dimensions=2,
        )

    def test_transform(self, texture: Any) -> None:
        """to_uv transforms uv."""
        uv = uniform(INPUTS, 2, 6)
        moved = self.subject.changed(to_uv=mi.ScalarTransform4f(np.diag([0.5, 0.3, 1.0, 1.0])))
        if moved is not None and "to_uv" not in self.subject.props:
            expected = colours(texture, (uv * [[0.5], [0.3]]).astype(np.float32))
            self.report.equal("to_uv scales uv", colours(moved, uv), expected, {"uv": uv}, share=0.03)

    def test_wavelengths(self, texture: Any) -> None:
        """Sampled wavelengths have the density of pdf_spectrum(), and the weight eval() / pdf."""
        variant = (mi.variant() or "").partition("_")[0] + "_ad_spectral"
        if variant not in mi.variants():
            return
        with self.subject.other_variant(variant):
            if (texture := self.subject.changed()) is None:
                return  # for example, data of another variant

            def sample(u: Any) -> Any:
                return texture.sample_spectrum(at((0, 0)), mi.sample_shifted(u[0]))[0][0]

            def density(w: Any) -> Any:
                return texture.pdf_spectrum(at((0, 0), mi.UnpolarizedSpectrum(w)))[0]

            si = at(uniform(INPUTS, 2, 7))
            si.wavelengths, weight = texture.sample_spectrum(si, mi.sample_shifted(mi.Float(uniform(INPUTS, 1, 8)[0])))
            found = rows(weight) * rows(texture.pdf_spectrum(si))
            self.report.equal("weight of a wavelength = eval() / pdf_spectrum()", found, texture.eval(si))
            ends = mi.MI_CIE_MIN, mi.MI_CIE_MAX
            self.report.density("samples follow pdf_spectrum()", sample, density, dimensions=1, ends=ends)

    def inputs(self, n: int) -> list[np.ndarray]:
        """Places, some beyond [0, 1)."""
        return [(3 * uniform(n, 2, 81) - 1).astype(np.float32)]

    def values(self, texture: Any, uv: Any, wavelengths: Any) -> dict[str, Any]:
        """The texture at given places."""
        return {"eval()": texture.eval(at(uv, wavelengths))}
