"""The parameters that materials share: reflectances, roughness, indices of refraction, metals.

Each function reads from the plugin's ``props`` and raises ValueError for wrong values.
"""

from __future__ import annotations

from math import inf
from pathlib import Path
from typing import Any

import mitsuba as mi

from ..parameters import choice, constant, reject, shown
from ..registry import create
from .facets import DISTRIBUTIONS, Distribution
from .nested import parts


def reflectance(props: mi.Properties, name: str, default: float | None = None) -> Any:
    """The texture of a reflectance, checked to lie in [0, 1] where it is constant; None if absent without default."""
    values = constant(props, name)
    if not all(0 <= v <= 1 for v in values):
        raise reject(props, name, shown(values), "reflectances between 0 and 1")
    if name in props:
        return props.get_texture(name)
    return None if default is None else props.get_texture(name, default)


def roughness(props: mi.Properties, allowed: tuple[str, ...] = tuple(DISTRIBUTIONS)) -> tuple[Distribution, Any]:
    """Reads ``distribution`` and the roughness that it calls for: (distribution, texture).

    The texture is None for an ideally smooth surface, i.e. if the roughness is absent or ``alpha`` is 0. An
    ``exponent`` alone means Phong's distribution, else Beckmann's is the default.
    """
    name = choice(props, "distribution", allowed, "phong" if "exponent" in props else None)
    distribution = DISTRIBUTIONS[name]
    parameter = distribution.parameter
    for other in ("alpha", "exponent"):
        if other != parameter and other in props:
            raise reject(props, other, props[other], f'"{parameter}" with distribution {name}')
    if parameter not in props:
        return distribution, None
    values = constant(props, parameter)
    low, high, within = distribution.range
    if not all(low <= v <= high for v in values):
        raise reject(props, parameter, shown(values), within)
    texture = props.get_unbounded_texture(parameter)
    return distribution, None if parameter == "alpha" and values == [0] else texture


def index(props: mi.Properties, name: str, default: float | str) -> float:
    """An index of refraction: a number > 0, or a name from Mitsuba's table."""
    value = props.get(name, default)
    try:
        number = mi.lookup_ior(props, name, default) if isinstance(value, str) else float(value)
    except RuntimeError as error:
        raise reject(props, name, value, "a number > 0 or" + str(error).split("Valid choices are:")[-1]) from None
    except TypeError:
        number = 0
    if not 0 < number < inf:
        raise reject(props, name, value, "a number > 0 or a name from Mitsuba's table of indices")
    return number


def metals() -> list[str]:
    """Names of the metals of which Mitsuba has tables, as far as it finds them."""
    folder = Path(str(mi.file_resolver().resolve("data/ior/Cu.k.spd"))).parent
    return sorted(p.name.removesuffix(".k.spd") for p in folder.glob("*.k.spd"))


def metal(props: mi.Properties) -> tuple[mi.Texture, mi.Texture]:
    """The textures (eta, k): given, or measured ones of ``material``, or those of a perfect mirror."""
    material = props.get("material", "none")
    if material == "none":
        for name in ("eta", "k"):
            values = constant(props, name)
            if not all(0 <= v < inf for v in values):
                raise reject(props, name, shown(values), "finite numbers >= 0")
        return props.get_unbounded_texture("eta", 0.0), props.get_unbounded_texture("k", 1.0)
    for name in ("eta", "k"):
        if name in props:
            raise reject(props, name, props[name], f'no "{name}" together with "material", which is {material!r}')
    try:
        conductor = create("conductor", material=material)
    except RuntimeError:
        names = metals()
        if not names or material in names:  # a table cannot be read
            raise
        raise reject(props, "material", material, "none, " + ", ".join(names)) from None
    found = parts(conductor)
    return found["eta"], found["k"]
