"""The parameters that materials share: reflectances, roughness, indices of refraction, metals.

Each function reads from the plugin's ``props`` and raises ValueError for what is wrong.
"""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi

from ..parameters import choice, reject
from .facets import DISTRIBUTIONS, Distribution


def constant(props: mi.Properties, name: str) -> list[float]:
    """The numbers of a parameter that is a number, a colour or a spectrum; empty for a texture or nothing.

    To be asked before the parameter is turned into a texture.
    """
    value = props.get(name)
    if value is None or isinstance(value, mi.Object):
        return []
    if isinstance(value, str):
        raise reject(props, name, value, "a number, a colour or a texture")
    return [float(v) for v in getattr(value, "values", value if hasattr(value, "__len__") else [value])]


def shown(values: list[float]) -> float | list[float]:
    """One number as such, several as a list."""
    values = [round(v, 6) for v in values]
    return values[0] if len(set(values)) == 1 else values


def reflectance(props: mi.Properties, name: str, default: float | None = None) -> mi.Texture | None:
    """The texture of a reflectance, checked to lie in [0, 1] where it is constant; None if absent without default."""
    values = constant(props, name)
    if not all(0 <= v <= 1 for v in values):
        raise reject(props, name, shown(values), "reflectances between 0 and 1")
    if name in props:
        return props.get_texture(name)
    return None if default is None else props.get_texture(name, default)


def conserve(props: mi.Properties, *names: str) -> None:
    """Raises an error if constant reflectances add up to more than 1 (s + d = 1, section 3.1.1)."""
    values = [constant(props, name) for name in names]
    if all(values):
        sums = [sum(v[i % len(v)] for v in values) for i in range(max(map(len, values)))]
        if max(sums) > 1 + 1e-6:
            raise reject(props, " + ".join(names), shown(sums), "a sum <= 1, or energy would be created")


def roughness(props: mi.Properties,
              allowed: tuple[str, ...] = tuple(DISTRIBUTIONS)) -> tuple[Distribution, mi.Texture | None]:
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
    low, high, allowed = distribution.range
    if not all(low <= v <= high for v in values):
        raise reject(props, parameter, shown(values), allowed)
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
    if not 0 < number < float("inf"):
        raise reject(props, name, value, "a number > 0 or a name from Mitsuba's table of indices")
    return number


def metal(props: mi.Properties) -> tuple[mi.Texture, mi.Texture]:
    """The textures (eta, k): given, or measured ones of ``material``, or those of a perfect mirror."""
    material = props.get("material", "none")
    if material == "none":
        for name in ("eta", "k"):
            values = constant(props, name)
            if not all(v >= 0 for v in values):
                raise reject(props, name, shown(values), "numbers >= 0")
        return props.get_unbounded_texture("eta", 0.0), props.get_unbounded_texture("k", 1.0)
    for name in ("eta", "k"):
        if name in props:
            raise reject(props, name, props[name], f'no "{name}" beside "material", which is {material!r}')
    try:
        conductor = mi.load_dict({"type": "conductor", "material": material})
    except RuntimeError:
        folder = Path(str(mi.file_resolver().resolve("data/ior/Cu.k.spd"))).parent
        names = sorted(p.name[:-6] for p in folder.glob("*.k.spd"))
        raise reject(props, "material", material, "none, " + ", ".join(names)) from None
    found = {}

    class Textures(mi.TraversalCallback):
        def put(self, name, value, flags):
            found[name] = value

    conductor.traverse(Textures())
    return found["eta"], found["k"]


def ambient(props: mi.Properties, default: mi.Texture | None = None) -> mi.Texture | None:
    """The texture of the reflectance of ambient light; ``default`` (a texture or None, i.e. black) if not given."""
    given = reflectance(props, "ambient")
    return default if given is None else given
