"""Tests that load a plugin again: in other variants, with other parameters, and with derivatives."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..scene import session
from .report import FAILS, NOTE, OK, SKIPPED, Report
from .statistics import rows
from .subject import Subject

#: Number of inputs, and of groups of four wavelengths for each input.
INPUTS, GROUPS = 48, 32

#: sRGB from XYZ, and the luminance of sRGB.
TO_RGB = np.array([[3.240479, -1.537150, -0.498535], [-0.969256, 1.875991, 0.041556], [0.055648, -0.204043, 1.057311]])
LUMINANCE = np.array([[0.212671, 0.715160, 0.072169]])

#: Exceptions of a plugin that does not accept a value or a variant.
REFUSED = (RuntimeError, ValueError, TypeError, KeyError, AttributeError)


def other_variants(variant: str) -> list[str]:
    """Returns the variants of this machine that are compared with ``variant``: scalar, mono, spectral, polarised."""
    device = variant.partition("_")[0]
    names = ["scalar_rgb", *(f"{device}_ad_{c}" for c in ("mono", "spectral", "spectral_polarized"))]
    return [name for name in names if name in mi.variants() and session.has_backend(name) and name != variant]


def evaluate(module: ModuleType, loaded: Any, apart: bool = True, light: bool | None = None) -> dict[str, np.ndarray]:
    """Returns name -> array (channels, n) of what a plugin returns for fixed inputs; in spectral variants as RGB.

    Each group has four wavelengths that lie ``apart``, or side by side.
    """
    inputs = module.inputs(INPUTS)
    wavelengths = np.linspace(360, 830, 4 * GROUPS, dtype=np.float32)
    wavelengths = wavelengths.reshape(4, GROUPS) if apart else wavelengths.reshape(GROUPS, 4).T
    if mi.is_spectral:
        inputs = [np.repeat(one, GROUPS, axis=1) for one in inputs]
    found: dict[str, np.ndarray] = {}
    if dr.is_jit_v(mi.Float):
        lanes = mi.UnpolarizedSpectrum(np.tile(wavelengths, INPUTS)) if mi.is_spectral else None
        for name, value in module.values(loaded, *(_dr(one) for one in inputs), lanes).items():
            found[name] = rows(value, inputs[0].shape[1])
    else:
        lanes = [module.values(loaded, *(_dr(one[:, i]) for one in inputs), None) for i in range(INPUTS)]
        found = {name: np.hstack([rows(row[name], 1) for row in lanes]) for name in lanes[0]}
    emits = module.EMITS if light is None else light
    return {name: _rgb(value, wavelengths, bool(emits)) for name, value in found.items()}


def _dr(values: np.ndarray) -> Any:
    """One, two or three rows of numbers as Mitsuba's type."""
    kind = {1: mi.Float, 2: mi.Point2f, 3: mi.Vector3f}[len(values)]
    if dr.is_jit_v(mi.Float):
        return kind(values[0] if len(values) == 1 else values)
    return kind(float(values[0])) if len(values) == 1 else kind(*map(float, values))


def _rgb(values: np.ndarray, wavelengths: np.ndarray, emits: bool) -> np.ndarray:
    """The colours of spectral values, shape (3, n); other values stay as they are, but one of each group is kept."""
    if not mi.is_spectral:
        return values
    if len(values) != 4:
        return values[:, ::GROUPS]
    values = values.reshape(4, INPUTS, GROUPS)
    xyz, d65 = _observer(wavelengths)
    weights = xyz if emits else xyz * d65
    step = (830 - 360) / (4 * GROUPS - 1)
    colour = np.einsum("cwg,wng->cn", weights, values)
    if emits:
        return np.asarray(TO_RGB @ colour * step / 106.856895)
    white = TO_RGB @ weights.sum(axis=(1, 2))
    return np.asarray(TO_RGB @ colour / white[:, None])


def _observer(wavelengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The colour-matching functions, shape (3, 4, groups), and the standard illuminant D65, shape (4, groups)."""
    si = dr.zeros(mi.SurfaceInteraction3f, GROUPS)
    si.wavelengths = mi.UnpolarizedSpectrum(wavelengths)
    xyz = np.array(mi.cie1931_xyz(mi.Float(wavelengths.ravel())), dtype=float).reshape(3, 4, GROUPS)
    return xyz, rows(mi.load_dict({"type": "d65"}).eval(si), GROUPS)


def compare(
    report: Report,
    test: str,
    values: dict[str, np.ndarray],
    expected: dict[str, np.ndarray],
    where: str,
    worst: str = FAILS,
) -> None:
    """Adds whether two results of :func:`evaluate` agree. Spectra agree with colours if they are grey; else loosely."""
    exact = "scalar" in where or "=" in where
    grey = {name: np.ptp(v, axis=0).max() <= 0.01 * v.max() for name, v in expected.items()}
    for name in expected.keys() & values.keys():
        a, b = values[name], expected[name]
        if len(b) == 1 and not exact and not all(grey.values()):
            continue  # a density may depend on the luminance of colours
        if (strict := exact or grey[name]) and len(a) == 1:
            b = LUMINANCE @ b if len(b) == 3 else b
        elif not strict:
            a, b = (LUMINANCE @ v if len(v) == 3 else v for v in (a, b))
        limits = (
            {"tolerance": 0.02, "share": 0.15, "floor": 2e-3}
            if strict
            else {"tolerance": 0.6, "share": 0.4, "floor": 0.05}
        )
        report.equal(test, a, b, f"{name}, {where}", worst=worst, **limits)


def test_variants(subject: Subject, module: ModuleType, variants: list[str], report: Report) -> None:
    """The plugin returns the same values in all variants."""
    before = mi.variant() or ""
    expected = evaluate(module, module.prepare(subject.load()))
    try:
        for variant in variants:
            subject.set_variant(variant)
            try:
                ready = module.prepare(subject.load())
                values = evaluate(module, ready)
                others = evaluate(module, ready, apart=False) if mi.is_spectral else values
            except REFUSED as error:
                text = session.message(error).strip().splitlines()
                report.add("variants agree", SKIPPED, f"{variant}: {text[0] if text else error!r}")
                continue
            # A plugin may depend on the luminance of its four wavelengths (principled with a tint, 3.9).
            alone = all(np.allclose(v, others[n], rtol=0.05, atol=1e-3 * np.abs(v).mean()) for n, v in values.items())
            if module.EMITS is None and mi.is_spectral:  # a spectrum may be a reflectance or a light
                as_light = evaluate(module, ready, light=True)
                for name, value in values.items():
                    if _distance(as_light[name], expected[name]) < _distance(value, expected[name]):
                        values[name] = as_light[name]
            compare(report, f"{variant} = {before}", values, expected, variant, FAILS if alone else NOTE)
    finally:
        subject.set_variant(before)


def _distance(values: np.ndarray, expected: np.ndarray) -> float:
    """The mean absolute difference."""
    return float(np.abs(values - expected).mean())


def numbers(subject: Subject) -> dict[str, tuple[str, Any]]:
    """Returns key -> (property, value) of each number and colour that the plugin exposes and reads as a property."""
    parameters = mi.traverse(subject.load())
    found = {}
    for key in parameters.keys():  # noqa: SIM118 (iterating reads the values, and fails for None)
        name = key.removesuffix(".value")
        if "." in name or name == "sampling_weight" or parameters.flags(key) & int(mi.ParamFlags.ReadOnly):
            continue
        try:
            value = parameters[key]
            number = isinstance(value, (float, mi.Float, mi.Color3f)) and dr.width(value) == 1
            if number and subject.load(**{name: as_property(value)}) is not None:
                found[key] = name, value
        except REFUSED:
            continue
    return found


def as_property(value: Any) -> Any:
    """A number or a colour as a property of ``mi.Properties``."""
    array = np.array(value, dtype=float).ravel()
    return float(array[0]) if array.size == 1 else mi.ScalarColor3f(*map(float, array))


def test_updates(subject: Subject, module: ModuleType, report: Report) -> None:
    """A parameter that is updated after loading has the effect of a parameter that is loaded."""
    exposed = numbers(subject)
    given = {name: as_property(value) for name, value in exposed.values()}
    for key, (name, value) in exposed.items():
        for start in (value, value * 0) if module.EMITS else (value,):
            new = value * 0.7 + 0.05
            try:
                expected = evaluate(module, module.prepare(subject.load(**given | {name: as_property(new)})))
                loaded = subject.load(**given | {name: as_property(start)})
            except REFUSED:
                continue
            ready, parameters = module.prepare(loaded), mi.traverse(loaded)
            if key not in parameters or type(parameters[key]) is not type(new):
                continue
            parameters[key] = new
            parameters.update()
            how = f"{key} = {np.round(np.array(new, dtype=float).ravel(), 4).tolist()} after loading"
            compare(report, "updated = loaded", evaluate(module, ready), expected, how)


def test_derivatives(subject: Subject, module: ModuleType, report: Report) -> None:
    """Derivatives with respect to exposed parameters are those of differences."""
    if "_ad_" not in (mi.variant() or ""):
        return
    inputs = [_dr(one) for one in module.inputs(512)]
    for key, (_, value) in numbers(subject).items():
        loaded = subject.load()
        ready, parameters = module.prepare(loaded), mi.traverse(loaded)
        fixed = parameters.flags(key) & int(mi.ParamFlags.NonDifferentiable) or isinstance(value, float)
        if fixed or np.abs(np.array(value)).min() == 0:
            continue

        def values(
            offset: Any, ready: Any = ready, parameters: Any = parameters, key: str = key, value: Any = value
        ) -> dict[str, Any]:
            parameters[key] = value + offset
            parameters.update()
            found = module.values(ready, *inputs, None)
            return {name: mi.unpolarized_spectrum(found[name]) for name in module.SMOOTH if name in found}

        h = 0.01 * float(np.abs(np.array(value)).max())
        more, less, half = values(h), values(-h), values(h / 2)
        offset = mi.Float(0)
        dr.enable_grad(offset)
        exact = values(offset)
        dr.forward(offset, flags=dr.ADFlag.ClearNone)
        for name in exact:
            difference = (rows(more[name], 512) - rows(less[name], 512)) / (2 * h)
            nearer = (rows(half[name], 512) - rows(less[name], 512)) / (1.5 * h)
            if np.abs(nearer - difference).sum() > 0.2 * np.abs(difference).sum():
                continue  # not smooth
            gradient = rows(dr.grad(exact[name]), 512)
            wrong = np.abs(gradient - difference).sum() / max(np.abs(difference).sum(), 1e-6 * difference.size)
            verdict = OK if wrong < 0.1 else NOTE if wrong < 0.5 else FAILS
            report.add("derivatives = differences", verdict, f"they differ by {wrong:.1%}", f"{name} by {key}")


def test_extremes(subject: Subject, module: ModuleType, report: Report) -> None:
    """Values stay finite and not negative with extreme parameters, unless the plugin refuses them."""
    for name, value in numbers(subject).values():
        for extreme in (0.0, 1e-3, 1.0):
            try:
                loaded = subject.load(**{name: as_property(value * 0 + extreme)})
                found = evaluate(module, module.prepare(loaded))
            except REFUSED:
                continue
            right = [np.isfinite(v).all() and (v >= -0.05 * v.max()).all() for v in found.values()]
            where = f"{name} = {extreme}"
            report.require(
                "finite with extreme parameters",
                right,
                "not finite, or negative",
                lambda _, w=where: w,
                worst=NOTE if extreme == 0 else FAILS,
            )
