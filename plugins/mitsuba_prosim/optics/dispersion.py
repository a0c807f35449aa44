"""Indices of refraction that depend on the wavelength: by an Abbe number, or by the name or formula of a material.

The functions of this module take wavelengths in nm. Cauchy's and Sellmeier's formulas use wavelengths in µm, as in the
catalogues of glass makers.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from typing import Any

import drjit as dr
import mitsuba as mi

from ..parameters import constant_values, for_message, number, reject
from ..registry import create

#: Wavelengths in nm of Fraunhofer's lines d, F and C. The Abbe number of a glass is V = (n_d - 1) / (n_F - n_C).
D, F, C = 587.5618, 486.1327, 656.2725

#: Wavelengths in nm that represent r, g and b: the centroids of sRGB's colour matching functions, negative parts
#: included (CIE 1931, equal energy). With these wavelengths, the displacement of a channel by dispersion is about the
#: mean displacement over the wavelengths of the channel.
RGB = (635.0, 544.0, 437.0)

#: Range of the formulas in nm. A wavelength outside the range counts as the nearer end.
SHORTEST, LONGEST = 300.0, 1000.0

#: Names of materials -> B and C of each term of Sellmeier's formula. bk7 (N-BK7), f2, sf10, sf11 and lasf9 (N-LASF9):
#: Schott, Optical Glass, data sheets. silica: Malitson 1965. diamond: Peter 1923. zirconia, cubic, with yttria: Wood
#: and Nassau 1982. water at 20 °C: Daimon and Masumura 2007. All were collected by refractiveindex.info (Polyanskiy
#: 2024).
MATERIALS: dict[str, tuple[tuple[float, float], ...]] = {
    "bk7": ((1.03961212, 0.00600069867), (0.231792344, 0.0200179144), (1.01046945, 103.560653)),
    "f2": ((1.34533359, 0.00997743871), (0.209073176, 0.0470450767), (0.937357162, 111.886764)),
    "sf10": ((1.61625977, 0.0127534559), (0.259229334, 0.0581983954), (1.07762317, 116.60768)),
    "sf11": ((1.73848403, 0.0136068604), (0.311168974, 0.0615960463), (1.17490871, 121.922711)),
    "lasf9": ((2.00029547, 0.0121426017), (0.298926886, 0.0538736236), (1.80691843, 156.530829)),
    "silica": ((0.6961663, 0.0684043**2), (0.4079426, 0.1162414**2), (0.8974794, 9.896161**2)),
    "diamond": ((0.3306, 0.1750**2), (4.3356, 0.1060**2)),
    "zirconia": ((1.347091, 0.062543**2), (2.117788, 0.166739**2), (9.452943, 24.320570**2)),
    "water": (
        (5.684027565e-1, 5.101829712e-3),
        (1.726177391e-1, 1.821153936e-2),
        (2.086189578e-2, 2.620722293e-2),
        (1.130748688e-1, 1.069792721e1),
    ),
}


@dataclass(init=False, eq=False)  # so that dr.freeze finds the numbers
class Dispersion:
    """The index of refraction of a material as a function of the wavelength λ in µm: n = A + B/λ² by Cauchy, or
    n² = 1 + Σ B λ²/(λ² - C) by Sellmeier.

    ``coefficients`` maps the names of the coefficients, A and B, or B1, C1, B2, C2 and so on, to their values.
    """

    coefficients: dict[str, mi.Float]

    def __init__(self, **coefficients: float) -> None:
        self.coefficients = {name: mi.Float(value) for name, value in coefficients.items()}
        dr.make_opaque(self.coefficients)

    @classmethod
    def sellmeier(cls, terms: Iterable[tuple[float, float]]) -> Dispersion:
        """Returns the dispersion by Sellmeier's formula with B and C of each term, as in :data:`MATERIALS`."""
        return cls(**{f"{letter}{i}": value for i, term in enumerate(terms, 1) for letter, value in zip("BC", term)})

    def index(self, wavelength: mi.Float | float) -> mi.Float:
        """Returns the index at a ``wavelength`` in nm; outside 300 to 1000 nm the nearer end counts."""
        square = dr.square(dr.clip(mi.Float(wavelength), SHORTEST, LONGEST) * 1e-3)
        values = list(self.coefficients.values())
        if "A" in self.coefficients:
            return values[0] + values[1] / square
        n2 = mi.Float(1)
        for b, c in zip(values[::2], values[1::2], strict=True):
            n2 = n2 + b * square / (square - c)
        return dr.sqrt(n2)


@dataclass(init=False, eq=False)
class Indices:
    """The indices of refraction inside and outside of an interface, each a number or a :class:`Dispersion`, read from
    the parameters of a plugin (:func:`read_index`): by default bk7 glass inside, air outside.
    """

    inside: float | Dispersion
    outside: float | Dispersion
    #: The index inside divided by the index outside; None if an index depends on the wavelength.
    eta: mi.Float | None

    def __init__(self, props: mi.Properties) -> None:
        self.inside, self.outside = read_index(props, "int", "bk7"), read_index(props, "ext", "air")
        self.eta = None
        if not isinstance(self.inside, Dispersion) and not isinstance(self.outside, Dispersion):
            self.eta = mi.Float(self.inside / self.outside)
            dr.make_opaque(self.eta)

    def etas(self, si: mi.SurfaceInteraction3f) -> list[mi.Float]:
        """Returns inside / outside: one number for each channel of a spectrum at ``si`` if it varies, else one."""
        if self.eta is not None:
            return [self.eta]
        return [mi.Float(_at(self.inside, w) / _at(self.outside, w)) for w in wavelengths(si)]

    def parameters(self) -> dict[str, Any]:
        """Returns a dictionary of the parameters that ``to_string`` and ``mi.traverse`` show: name -> value.

        ``eta`` is None if an index depends on the wavelength. An index that is a number has the name ``int_ior`` or
        ``ext_ior``, and only ``to_string`` shows it. Another has a name for each coefficient, such as ``int_B1``.
        """
        parameters: dict[str, Any] = {"eta": self.eta}
        for side, ior in (("int", self.inside), ("ext", self.outside)):
            values = ior.coefficients if isinstance(ior, Dispersion) else {"ior": ior}
            parameters |= {f"{side}_{name}": value for name, value in values.items()}
        return parameters


def _at(ior: float | Dispersion, wavelength: mi.Float | float) -> mi.Float | float:
    return ior.index(wavelength) if isinstance(ior, Dispersion) else ior


def index(props: mi.Properties, name: str, default: float | str) -> float:
    """Returns the index of refraction in the parameter ``name`` (or ``default``): a finite number > 0, or the name of a
    material in Mitsuba's table, such as "water". Raises ValueError for other values.
    """
    value = props.get(name, default)
    try:
        result = mi.lookup_ior(props, name, default) if isinstance(value, str) else float(value)
    except RuntimeError as error:
        names = str(error).split("Valid choices are:")[-1].strip()
        raise reject(props, name, value, f"a number > 0, or {names}") from None
    except TypeError:
        result = 0
    if not 0 < result < inf:
        raise reject(props, name, value, "a number > 0 or a name from Mitsuba's table of indices")
    return result


def optical_constant(props: mi.Properties, name: str, default: float, open_below: bool = False) -> mi.Texture:
    """Returns the parameter ``name`` (or ``default``), an index of refraction or an extinction coefficient, as a
    texture. Raises ValueError if a constant value is below 0 or not finite, or, with ``open_below``, if it is 0.

    In spectral variants, Mitsuba makes a reflectance of a colour, which is at most 1. So a colour with a channel above
    1 is interpolated linearly between the wavelengths :data:`RGB`.
    """
    values = constant_values(props, name)
    if not all(0 <= v < inf and (v > 0 or not open_below) for v in values):
        raise reject(props, name, for_message(values), f"finite numbers {'>' if open_below else '>='} 0")
    if mi.is_spectral and len(values) == 3 and max(values) > 1 and not hasattr(props[name], "values"):
        r, g, b = values
        wavelengths = ", ".join(map(str, (360.0, *RGB[::-1], 830.0)))
        return create("irregular", wavelengths=wavelengths, values=f"{b}, {b}, {g}, {r}, {r}")
    return props.get_unbounded_texture(name, default)


def read_index(props: mi.Properties, side: str, default: str) -> float | Dispersion:
    """Reads the index of refraction on one ``side`` of an interface, "int" or "ext", from the parameters of a plugin.

    It is a number if it is the same at all wavelengths: the parameter ``<side>_ior`` alone, or the material
    ``default``. It is a :class:`Dispersion` by ``<side>_ior`` with the Abbe number ``<side>_abbe``, or by
    ``<side>_material``. Raises ValueError for wrong values, for other combinations, and for an index that is not
    positive and finite from 360 to 830 nm.
    """
    ior, abbe, material = (f"{side}_{name}" for name in ("ior", "abbe", "material"))
    if material in props:
        for name in (ior, abbe):
            if name in props:
                raise reject(props, name, props[name], f'no "{name}" together with "{material}"')
        return Dispersion.sellmeier(_terms(props, material))
    n = index(props, ior, default)
    if abbe not in props:
        return n
    if ior not in props:
        raise reject(props, abbe, props[abbe], f'"{ior}", the index at 587.6 nm, together with "{abbe}"')
    a, b = cauchy(n, number(props, abbe, None, 1, 1000))
    if not min(a + b / 0.36**2, a + b / 0.83**2) > 0:
        raise reject(props, abbe, props[abbe], "a number with which the index is > 0 from 360 to 830 nm")
    return Dispersion(A=a, B=b)


def _terms(props: mi.Properties, name: str) -> tuple[tuple[float, float], ...]:
    """Reads B and C of each term of Sellmeier's formula: the name of a material, or the numbers B1, C1, B2, C2, ..."""
    text = str(props[name]).lower()
    if text in MATERIALS:
        return MATERIALS[text]
    with suppress(ValueError):  # a word is no number, or a number has no partner
        values = iter([float(word) for word in text.split(",")])
        terms = tuple(zip(values, values, strict=True))
        if all(0 < dr.slice(Dispersion.sellmeier(terms).index(w)) < inf for w in range(360, 831, 10)):
            return terms
    numbers = "the numbers B1, C1, B2, C2, ... of Sellmeier's formula for an index > 0 from 360 to 830 nm"
    raise reject(props, name, props[name], f"{', '.join(MATERIALS)}, or {numbers}")


def cauchy(n_d: float, abbe: float) -> tuple[float, float]:
    """Returns Cauchy's coefficients A and B, for λ in µm, from the index at line d and the Abbe number."""
    b = (n_d - 1) / abbe / (1e6 / F**2 - 1e6 / C**2)
    return n_d - b * 1e6 / D**2, b


def wavelengths(si: mi.SurfaceInteraction3f) -> list[mi.Float | float]:
    """Returns the wavelength in nm of each channel of a spectrum at ``si``: its wavelengths in spectral variants, the
    constants :data:`RGB` in RGB variants, Fraunhofer's line d in monochromatic variants.
    """
    if mi.is_spectral:
        return list(si.wavelengths)
    return [D] if mi.is_monochromatic else list(RGB)


def choose(p: Sequence[mi.Float | float], sample: mi.Float) -> tuple[mi.UInt32, mi.Float]:
    """Chooses a list index k with the probability ``p[k]``, by ``sample`` in [0, 1); the probabilities sum up to 1.

    Returns ``(k, rest)``: ``rest`` is a new random number in [0, 1], the relative position of ``sample`` within the
    interval of length ``p[k]`` that stands for k.
    """
    k, below, width, total = mi.UInt32(0), mi.Float(0), mi.Float(p[0]), mi.Float(p[0])
    for j in range(1, len(p)):
        further = (sample >= total) & (p[j] > 0)  # an index of probability 0 is never chosen
        k = dr.select(further, mi.UInt32(j), k)
        below, width = dr.select(further, total, below), dr.select(further, p[j], width)
        total = total + p[j]
    rest = dr.select(width > 0, (sample - below) / dr.select(width > 0, width, 1), 0)
    return k, dr.clip(rest, 0, 1)


def pick(k: mi.UInt32, values: Sequence[mi.Float | float]) -> mi.Float:
    """Returns ``values[k]``, where each lane of a Dr.Jit array has its own list index ``k``."""
    picked = mi.Float(values[0])
    for j in range(1, len(values)):
        picked = dr.select(k == j, values[j], picked)
    return picked


def spectrum(values: Sequence[mi.Float]) -> mi.UnpolarizedSpectrum | mi.Float:
    """Returns a spectrum whose channels are the ``values``; a list of one value is returned as a number."""
    return mi.UnpolarizedSpectrum(*values) if len(values) > 1 else values[0]
