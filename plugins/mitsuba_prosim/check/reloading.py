"""Tests that load a plugin again: in other variants, with other parameters, and with derivatives.

The module of a kind says what is compared: ``values`` returns name -> value for the arrays of ``inputs``. ``prepare``
puts a plugin into a scene, if its kind needs one. ``LIGHT`` tells whether spectra may be light or reflectances, and
``SMOOTH`` names the values that have derivatives.
"""

from __future__ import annotations

from collections.abc import Iterator
from types import ModuleType
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..scene import session
from .inputs import rows
from .report import FAILS, NOTE, OK, SKIPPED, Report
from .subject import Subject

#: Number of inputs, of groups of four wavelengths for each input, and of inputs of derivatives.
INPUTS, GROUPS, DERIVATIVES = 48, 32, 512

#: Range of the wavelengths in nm, and the integral of the CIE's function of luminance.
SPECTRUM, LUMINANCE = (360, 830), 106.856895

#: Exceptions of a plugin that does not accept a value or a variant.
REFUSED = (RuntimeError, ValueError, TypeError, KeyError, AttributeError)


def other_variants(variant: str) -> list[str]:
    """Returns the variants of this machine that are compared with ``variant``: scalar, mono, spectral, polarised."""
    device = variant.partition("_")[0]
    names = ["scalar_rgb", *(f"{device}_ad_{c}" for c in ("mono", "spectral", "spectral_polarized"))]
    return [name for name in names if name in mi.variants() and session.has_backend(name) and name != variant]


def ready(module: ModuleType, loaded: Any) -> Any:
    """Returns a loaded plugin, in a scene if its kind needs one."""
    return module.prepare(loaded) if hasattr(module, "prepare") else loaded


def evaluate(module: ModuleType, plugin: Any, light: bool = False) -> dict[str, np.ndarray]:
    """Returns name -> array (channels, n) of what a plugin returns for fixed inputs; in spectral variants as RGB."""
    inputs = module.inputs(INPUTS)
    if not dr.is_jit_v(mi.Float):
        lanes = [module.values(plugin, *(_dr(one[:, i]) for one in inputs), None) for i in range(INPUTS)]
        return {name: np.hstack([rows(row[name], 1) for row in lanes]) for name in lanes[0]}
    if not mi.is_spectral:
        found = module.values(plugin, *map(_dr, inputs), None)
        return {name: rows(value, INPUTS) for name, value in found.items()}
    low, high = SPECTRUM
    middles = low + (np.arange(4 * GROUPS) + 0.5) / (4 * GROUPS) * (high - low)
    wavelengths = mi.UnpolarizedSpectrum(np.tile(middles.reshape(4, GROUPS), INPUTS))
    found = module.values(plugin, *(_dr(np.repeat(one, GROUPS, axis=1)) for one in inputs), wavelengths)
    return {name: _rgb(rows(value, INPUTS * GROUPS), wavelengths, light) for name, value in found.items()}


def _dr(values: np.ndarray) -> Any:
    """One, two or three rows of numbers, or numbers of scalar variants, as Mitsuba's type."""
    kind = {1: mi.Float, 2: mi.Point2f, 3: mi.Vector3f}[len(values)]
    return kind(values[0]) if len(values) == 1 else kind(*values)


def _rgb(values: np.ndarray, wavelengths: Any, light: bool) -> np.ndarray:
    """The colours of spectral values, shape (3, n); other values stay as they are, but one of each group is kept."""
    if len(values) != 4:
        return values[:, ::GROUPS]
    si = dr.zeros(mi.SurfaceInteraction3f, values.shape[1])
    si.wavelengths = wavelengths
    illuminant = 1 if light else rows(mi.load_dict({"type": "d65"}).eval(si))
    observer = np.array([np.array(mi.cie1931_xyz(one)) for one in wavelengths])

    def colour(spectrum: np.ndarray) -> np.ndarray:
        xyz = (observer * (spectrum * illuminant)[:, None]).mean(axis=0).reshape(3, INPUTS, GROUPS).mean(axis=2)
        return np.array(mi.xyz_to_srgb(mi.Color3f(xyz)), dtype=float)

    factor = (SPECTRUM[1] - SPECTRUM[0]) / LUMINANCE
    return colour(values) * factor if light else colour(values) / colour(np.ones_like(values))


def compare(
    report: Report, test: str, values: dict[str, np.ndarray], expected: dict[str, np.ndarray], how: str
) -> None:
    """Adds whether two results of :func:`evaluate` agree; loosely for colours of variants that have other ones."""
    grey = {name: np.ptp(v, axis=0).max() <= 0.01 * v.max() for name, v in expected.items()}
    exact = "mono" not in how and "spectral" not in how
    for name in expected.keys() & values.keys():
        a, b = values[name], expected[name]
        if not exact and len(b) == 1 and not all(grey.values()):
            continue  # a density may depend on the luminance of colours
        if not exact and (len(a) != len(b) or not grey[name]):
            a, b = (mi.luminance(mi.Color3f(v)) if len(v) == 3 else v for v in (a, b))
        tolerance, share, floor = (0.02, 0.15, 2e-3) if exact or grey[name] else (0.6, 0.4, 0.05)
        report.equal(test, a, b, f"{name}, {how}", tolerance=tolerance, share=share, floor=floor)


def test_variants(subject: Subject, module: ModuleType, report: Report) -> None:
    """The plugin returns the same values in all variants."""
    expected = evaluate(module, ready(module, subject.load()))
    for variant in other_variants(mi.variant() or ""):
        with subject.other_variant(variant):
            try:
                plugin = ready(module, subject.load())
                found = [evaluate(module, plugin, light) for light in module.LIGHT]
            except REFUSED as error:
                report.add("variants agree", SKIPPED, f"{variant}: {session.message(error).strip() or error!r}")
                continue
        # A texture's spectrum may be a reflectance or light: one of both has the colours.
        nearest = min(found, key=lambda one: sum(np.abs(v - expected[n]).sum() for n, v in one.items()))
        compare(report, "variants agree", nearest, expected, variant)


def numbers(subject: Subject) -> Iterator[tuple[str, str, Any]]:
    """Yields the key, the property and the value of each number and colour that is exposed and read as a property."""
    parameters = mi.traverse(subject.load())
    for key in parameters.keys():  # noqa: SIM118 (iterating reads the values, and fails for None)
        name = key.removesuffix(".value")
        if "." in name or name == "sampling_weight" or parameters.flags(key) & int(mi.ParamFlags.ReadOnly):
            continue
        try:
            value = parameters[key]
            if isinstance(value, (float, mi.Float, mi.Color3f)) and dr.width(value) == 1:
                subject.load(**{name: as_property(value)})
                yield key, name, value
        except REFUSED:
            continue


def as_property(value: Any) -> Any:
    """A number or a colour as a property of ``mi.Properties``."""
    array = np.array(value, dtype=float).ravel()
    return float(array[0]) if array.size == 1 else mi.ScalarColor3f(*map(float, array))


def test_updates(subject: Subject, module: ModuleType, report: Report) -> None:
    """A parameter that is updated after loading has the effect of a parameter that is loaded; a lamp may be black."""
    exposed = list(numbers(subject))
    given = {name: as_property(value) for _, name, value in exposed}
    for key, name, value in exposed:
        for start in (value, value * 0) if module.LIGHT == (True,) else (value,):
            new = value * 0.7 + 0.05
            try:
                expected = evaluate(module, ready(module, subject.load(**given | {name: as_property(new)})))
                loaded = subject.load(**given | {name: as_property(start)})
            except REFUSED:
                continue
            plugin, parameters = ready(module, loaded), mi.traverse(loaded)
            if key in parameters and type(parameters[key]) is type(new):
                parameters[key] = new
                parameters.update()
                compare(report, "updated = loaded", evaluate(module, plugin), expected, f"{key} = {as_property(new)}")


def test_derivatives(subject: Subject, module: ModuleType, report: Report) -> None:
    """Derivatives with respect to exposed colours are those of differences, where these do not depend on the step."""
    inputs = [_dr(one) for one in module.inputs(DERIVATIVES)]
    for key, _, value in numbers(subject) if "_ad_" in (mi.variant() or "") else ():
        loaded = subject.load()
        plugin, parameters = ready(module, loaded), mi.traverse(loaded)
        size = np.abs(np.array(value))
        if parameters.flags(key) & int(mi.ParamFlags.NonDifferentiable) or isinstance(value, float) or not size.min():
            continue

        def values(offset: Any, plugin: Any = plugin, parameters: Any = parameters, start: Any = (key, value)) -> dict:
            parameters[start[0]] = start[1] + offset
            parameters.update()
            found = module.values(plugin, *inputs, None)
            return {name: mi.unpolarized_spectrum(found[name]) for name in module.SMOOTH if name in found}

        h = 0.01 * float(size.max())
        more, less, half = values(h), values(-h), values(h / 2)
        offset = mi.Float(0)
        dr.enable_grad(offset)
        exact = values(offset)
        dr.forward(offset, flags=dr.ADFlag.ClearNone)
        for name in exact:
            difference, nearer = (
                (rows(a[name], DERIVATIVES) - rows(less[name])) / step for a, step in ((more, 2 * h), (half, 1.5 * h))
            )
            gradient, total = rows(dr.grad(exact[name]), DERIVATIVES), np.abs(difference).sum()
            if np.abs(nearer - difference).sum() <= 0.2 * total:
                wrong = np.abs(gradient - difference).sum() / max(total, 1e-6 * difference.size)
                verdict = OK if wrong < 0.1 else NOTE if wrong < 0.5 else FAILS
                report.add("derivatives = differences", verdict, f"they differ by {wrong:.1%}", f"{name} by {key}")


def test_extremes(subject: Subject, module: ModuleType, report: Report) -> None:
    """Values stay finite and not negative with extreme parameters, unless the plugin refuses them."""
    for _, name, value in numbers(subject):
        for extreme in (1e-3, 1.0):
            try:
                loaded = subject.load(**{name: as_property(value * 0 + extreme)})
                found = evaluate(module, ready(module, loaded))
            except REFUSED:
                continue
            right = [np.isfinite(v).all() and (v >= -0.05 * v.max()).all() for v in found.values()]
            report.require("finite with extreme parameters", right, f"{name} = {extreme}")


TESTS = test_updates, test_derivatives, test_extremes, test_variants
