"""The tests of all kinds of plugins: samples against densities, and plugins that are loaded again in other variants,
with other parameters, and with derivatives.
"""

from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..scene import session
from .inputs import octant, rows, rows_of, to_drjit
from .report import NOTE, SKIPPED, Report
from .subject import REFUSED, Subject, on_copies

#: Number of inputs, of groups of four wavelengths for each input, and of inputs of derivatives.
INPUTS, GROUPS, DERIVATIVES = 48, 32, 512

Values = dict[str, np.ndarray]


def motion() -> Any:
    """A translation and a rotation."""
    return mi.ScalarTransform4f().translate([0.4, -0.2, 0.3]).rotate([0.48, 0.8, 0.36], 70)


class Tests:
    """The tests of a kind of plugins: the methods ``test_...``, which run in each of the :meth:`cases`.

    A kind that has ``inputs`` and ``values`` is also loaded again, by the methods ``again_...``: ``values`` returns
    name -> value for the arrays of ``inputs``. ``LIGHT`` tells whether spectra may be light or reflectances, and
    ``SMOOTH`` names the values that have derivatives. ``everywhere`` is a test that also runs in other variants. A kind
    that samples directions has ``draw``, which returns direction, weight and density (0 for ideal lobes), and
    ``evaluate``, which returns value and density.
    """

    LIGHT: tuple[bool, ...] = (False,)
    SMOOTH: tuple[str, ...] = ()
    inputs: Callable[[int], list[np.ndarray]]
    values: Callable[..., dict[str, Any]]
    draw: Callable[..., tuple[Any, Any, Any]]
    evaluate: Callable[..., tuple[Any, Any]]
    everywhere: Callable[..., None]

    def __init__(self, subject: Subject, report: Report) -> None:
        self.subject, self.report = subject, report

    def prepared(self, loaded: Any) -> Any:
        """The plugin, in a scene if its kind needs one."""
        return on_copies(loaded) if hasattr(self, "values") and not isinstance(loaded, mi.Sensor) else loaded

    def cases(self) -> Iterator[Any]:
        """What each test gets in turn."""
        yield self.prepared(self.subject.load())

    def tests(self) -> Iterator[tuple[str, Callable[[], None]]]:
        """Yields the name of each test, and a function that runs it."""
        for name in [*vars(type(self)), *vars(Tests)]:
            group, _, words = name.partition("_")
            if group == "test":
                yield words.replace("_", " "), partial(self.run, getattr(self, name))
            if group == "again" and hasattr(self, "values"):
                yield words, getattr(self, name)

    def run(self, test: Callable[[Any], None]) -> None:
        """Runs a test in each case."""
        for case in self.cases():
            test(case)

    def octants(self, test: str, where: str, *terms: tuple[np.ndarray, np.ndarray]) -> None:
        """Compares two samples of light, each the light (channels, n) and where it is (3, n), in each octant."""
        for side in range(8):
            a, b = (v.mean(axis=0) * (octant(p) == side) for v, p in terms)
            self.report.same_mean(test, a, b, f"{where} octant {side}".strip())

    def density(self, where: str, plugin: Any, ctx: Any, at: Callable[[int], Any]) -> None:
        """Samples of :meth:`draw` have the density of :meth:`evaluate`; ``at(n)`` returns n equal interactions."""

        def sample(u: Any) -> tuple[Any, Any]:
            direction, _, pdf = self.draw(plugin, ctx, at(dr.width(u)), u)
            return direction, pdf > 0

        def pdf(direction: Any) -> Any:
            return self.evaluate(plugin, ctx, at(dr.width(direction)), direction)[1]

        self.report.density("samples follow pdf()", sample, pdf, where)

    def samples(self, weight: Any, pdf: Any, value: Any, stated: Any, where: Any = "", on: Any = True) -> None:
        """Weights and densities of samples are those of ``value`` and the ``stated`` density."""
        dr.eval(weight, pdf, value, stated)
        sent, value = rows(weight, whole=True) * rows(pdf), rows(value, whole=True)
        self.report.equal("weight of a sample = eval() / pdf()", sent, value, where, on=on)
        self.report.equal("pdf of a sample = pdf()", pdf, stated, where, on=on)

    def evaluated(self, plugin: Any, light: bool = False) -> Values:
        """The values of fixed inputs, each an array (channels, n); in spectral variants as RGB."""
        inputs = self.inputs(INPUTS)
        if not dr.is_jit_v(mi.Float):
            lanes = [self.values(plugin, *(to_drjit(one[:, i]) for one in inputs), None) for i in range(INPUTS)]
            return {name: np.hstack([rows(row[name], 1) for row in lanes]) for name in lanes[0]}
        groups, spectrum, wavelengths = 1, np.linspace(360, 830, 4 * GROUPS), None
        if mi.is_spectral:
            groups, wavelengths = GROUPS, mi.UnpolarizedSpectrum(np.tile(spectrum.reshape(4, GROUPS), INPUTS))
        found = self.values(plugin, *(to_drjit(np.repeat(one, groups, axis=1)) for one in inputs), wavelengths)

        def colours(values: np.ndarray) -> np.ndarray:
            if groups == 1 or len(values) != 4:
                return values.reshape(len(values), INPUTS, groups).mean(axis=2)
            lanes = values.reshape(4, INPUTS, GROUPS).swapaxes(0, 1).reshape(INPUTS, -1)
            return np.array([np.array(mi.spectrum_list_to_srgb(spectrum, lane, False, not light)) for lane in lanes]).T

        return dict(zip(found, map(colours, rows_of(found.values(), INPUTS * groups))))

    def loaded(self, **changes: Any) -> Values:
        """The values of the plugin with other parameters; no values if it refuses them."""
        loaded = self.subject.changed(**changes)
        return {} if loaded is None else self.evaluated(self.prepared(loaded))

    def compare(self, test: str, values: Values, expected: Values, how: str) -> None:
        """Adds whether two results of :meth:`evaluated` agree; loosely for colours of mono and spectral variants."""
        grey = {name: np.ptp(v, axis=0).max() <= 0.01 * v.max() for name, v in expected.items()}
        exact = "mono" not in how and "spectral" not in how
        for name in expected.keys() & values.keys():
            a, b = values[name], expected[name]
            if not exact and len(b) == 1 and not all(grey.values()):
                continue  # a density may depend on the luminance of colours
            if not exact and (len(a) != len(b) or not grey[name]):
                a, b = (mi.luminance(mi.Color3f(v)) if len(v) == 3 else v for v in (a, b))
            tolerance, share = ((0.02, 2e-3), 0.15) if exact or grey[name] else ((0.6, 0.05), 0.4)
            self.report.equal(test, a, b, f"{name}, {how}", tolerance, share=share)

    def exposed(self, *kinds: Any) -> Iterator[tuple[str, int, Any]]:
        """Yields the key, the flags and the value of everything exposed that can change and is of the ``kinds``."""
        parameters = mi.traverse(self.subject.load())
        for key in parameters.keys():  # noqa: SIM118 (iterating reads the values, and fails for None)
            with suppress(*REFUSED):
                value, flags = parameters[key], parameters.flags(key)
                if isinstance(value, kinds) and not flags & int(mi.ParamFlags.ReadOnly):
                    yield key, flags, value

    def properties(self, *kinds: Any) -> Iterator[tuple[str, str, Any]]:
        """Yields the key, the property and the value of each number or what is of ``kinds``, if it is a property."""
        for key, _, value in self.exposed(float, mi.Float, mi.Color3f, mi.Point3f, *kinds):
            name = key.replace(".value", "")
            if "." not in name and name != "sampling_weight" and dr.width(value) == 1:
                with suppress(*REFUSED):
                    self.subject.load(**{name: as_property(value)})
                    yield key, name, value

    def again_updates(self) -> None:
        """A parameter that is updated after loading has the effect of one that is loaded."""
        given = {name: as_property(value) for _, name, value in self.properties()}
        for key, name, value in self.properties(mi.AffineTransform4f):
            moves = isinstance(value, mi.AffineTransform4f)
            new = mi.AffineTransform4f(motion()) @ value if moves else value * 0.7 + 0.05
            expected = self.loaded(**given | {name: as_property(new)})
            for start in (value,) if moves or not self.LIGHT[0] else (value, value * 0):
                loaded = self.subject.changed(**given | {name: as_property(start)})
                parameters = mi.traverse(loaded) if expected and loaded else {}
                if key in parameters and type(parameters[key]) is type(new):
                    plugin = self.prepared(loaded)
                    try:
                        parameters[key] = new
                        parameters.update()
                    except TypeError as error:  # of a number of Python
                        self.report.add("exposed parameters can be set", NOTE, str(error), key)
                        continue
                    where = f"{key} = {as_property(new)}"
                    self.compare("updated = loaded", self.evaluated(plugin), expected, where)

    def again_derivatives(self) -> None:
        """Derivatives with respect to exposed values are those of differences, where the step does not matter."""
        inputs = [to_drjit(one) for one in self.inputs(DERIVATIVES)]
        fixed = int(mi.ParamFlags.NonDifferentiable | mi.ParamFlags.Discontinuous)
        kinds = mi.Float, mi.Color3f, mi.Point3f, mi.TensorXf
        for key, flags, value in self.exposed(*kinds) if "_ad_" in (mi.variant() or "") and self.SMOOTH else ():
            loaded = self.subject.load()
            plugin, parameters = self.prepared(loaded), mi.traverse(loaded)
            if flags & fixed or not (size := np.abs(np.array(value))).min():
                continue
            smooth = self.SMOOTH[:1] if dr.is_tensor_v(value) else self.SMOOTH  # samples move with a tensor

            def changed(offset: Any) -> dict[str, Any]:
                parameters[key] = value + offset  # noqa: B023 (called here)
                parameters.update()  # noqa: B023
                found = self.values(plugin, *inputs, None)  # noqa: B023
                return {name: mi.unpolarized_spectrum(found[name]) for name in smooth if name in found}  # noqa: B023

            def difference(h: float) -> Values:
                step = dr.opaque(mi.Float, h)  # a number would be a part of the kernel
                more, less = changed(step), changed(-step)
                return dict(zip(more, rows_of(((more[name] - less[name]) / (2 * step) for name in more), DERIVATIVES)))

            h, offset = 0.01 * float(size.max()), mi.Float(0)
            wide, near, nearest = (difference(h / parts) for parts in (1, 2, 16))
            dr.enable_grad(offset)
            exact = changed(offset)
            dr.forward(offset, flags=dr.ADFlag.ClearNone)
            for name, found in exact.items():
                slope = np.abs(near[name])
                steady = changes = slope * h > 3e-4 * np.abs(rows(found))
                for other in (wide, nearest):  # an edge may lie between two of them
                    steady = steady & (np.abs(other[name] - near[name]) <= 0.05 * slope)
                test, where = "derivatives = differences", f"{name} by {key}"
                if steady.sum() > 0.1 * changes.sum():  # else the steps agree by chance
                    self.report.equal(test, dr.grad(found), nearest[name], where, on=steady, share=0.05)

    def again_extremes(self) -> None:
        """Values stay finite and not negative with extreme parameters, unless the plugin refuses them."""
        for _, name, value in self.properties():
            for extreme in (1e-3, 1.0):
                for found in self.loaded(**{name: as_property(value * 0 + extreme)}).values():
                    right = np.isfinite(found) & (found >= -0.05 * found.max())
                    self.report.require("finite with extreme parameters", right, f"{name} = {extreme}")

    def again_variants(self) -> None:
        """The plugin returns the same values in all variants of this device: those of RGB, which tell the colours, and
        scalar, mono, spectral, polarised.
        """
        before, results = mi.variant() or "", dict[str, list[Values]]()
        rgb, *others = (f"{before.partition('_')[0]}_ad_{c}" for c in ("rgb", "mono", "spectral", "spectral_polarized"))
        try:
            for variant in [rgb, "scalar_rgb", *others]:
                if variant not in mi.variants() or not session.has_backend(variant):
                    continue
                try:
                    if variant != mi.variant():
                        self.subject.set_variant(variant)
                    plugin = self.prepared(self.subject.load())
                    values = [self.evaluated(plugin, light) for light in self.LIGHT]
                    if variant != before and dr.is_jit_v(mi.Float) and hasattr(self, "everywhere"):
                        self.everywhere(plugin)
                    results[variant] = values
                except (*REFUSED, ImportError) as error:
                    text = f"{variant}: {session.message(error).strip() or error!r}"
                    self.report.add("variants agree", SKIPPED, text)
        finally:
            if mi.variant() != before:
                self.subject.set_variant(before)
        # A texture's spectrum may be a reflectance or light: one of both has the colours.
        for variant, found in [*results.items()][1:]:
            expected = next(iter(results.values()))[0]
            nearest = min(found, key=lambda one: sum(np.abs(v - expected[n]).sum() for n, v in one.items()))
            self.compare("variants agree", nearest, expected, variant)


def as_property(value: Any) -> Any:
    """A value as a property of ``mi.Properties``."""
    if isinstance(value, mi.AffineTransform4f):
        return mi.ScalarTransform4f(np.array(value.matrix, dtype=float).reshape(4, 4))
    array = np.array(value, dtype=float).ravel()
    kind = mi.ScalarColor3f if isinstance(value, mi.Color3f) else mi.ScalarPoint3f
    return float(array[0]) if array.size == 1 else kind(*map(float, array))
