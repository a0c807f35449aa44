"""Reads the parameters of plugins, rejects wrong values, and shows parameters to ``mi.traverse`` and ``str``."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, isfinite
from typing import Any

import mitsuba as mi


def reject(props: mi.Properties, name: str, value: Any, allowed: str) -> ValueError:
    """Returns the error for a parameter whose value is not allowed; the caller raises the error.

    ``name`` is the name of the parameter. ``value`` is the value of the parameter, or None if the parameter is missing.
    ``allowed`` is a phrase such as ``"a number >= 0"``.
    """
    where = f'"{props.id()}" ({props.plugin_name()})' if props.id() else props.plugin_name()
    return ValueError(
        f'{where}: parameter "{name}" is {"missing" if value is None else repr(value)}; allowed: {allowed}.'
    )


def number(
    props: mi.Properties, name: str, default: float | None, low: float, high: float = inf, open_below: bool = False
) -> float:
    """Reads a finite number from ``low`` to ``high``; ``low`` itself is not allowed if ``open_below``.

    Without a ``default`` (None) the parameter is required. Raises ValueError for other values.
    """
    value = props.get(name, default)
    if not _is_number(value) or not low <= value <= high or not isfinite(value) or (open_below and value == low):
        raise reject(props, name, value, "a number" + _bounds(low, high, open_below))
    return float(value)


def whole(props: mi.Properties, name: str, default: int | None, low: int, high: int | None = None) -> int:
    """Reads a whole number from ``low`` to ``high``: an integer, or a float such as 10.0.

    Without a ``default`` (None) the parameter is required. Raises ValueError for other values.
    """
    value = props.get(name, default)
    top = inf if high is None else high
    if not _is_number(value) or not low <= value <= top or not isfinite(value) or value != int(value):
        raise reject(props, name, value, "a whole number" + _bounds(low, top, False))
    return int(value)


def choice(props: mi.Properties, name: str, allowed: Sequence[str], default: str | None = None) -> str:
    """Reads one of the words ``allowed``; the first word is the default. Raises ValueError for other values."""
    value = props.get(name, allowed[0] if default is None else default)
    if value not in allowed:
        raise reject(props, name, value, "one of " + ", ".join(allowed) if len(allowed) > 2 else " or ".join(allowed))
    return value


def nested_integrator(props: mi.Properties) -> mi.SamplingIntegrator:
    """Returns the integrator that is nested in a plugin.

    Raises ValueError if the plugin has no nested integrator, several nested objects, or an object of another kind.
    """
    children = [child for _, child in props.objects()]
    if len(children) != 1 or not isinstance(children[0], mi.SamplingIntegrator):
        found = ", ".join(child.class_name() for child in children) or "nothing"
        allowed = "one integrator that takes samples from a sensor: path, volpath, direct, aov or prosim, for example"
        raise reject(props, "integrator", found, allowed)
    return children[0]


def _is_number(value: Any) -> bool:
    """Tells whether ``value`` is a number; a boolean is not."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _bounds(low: float, high: float, open_below: bool) -> str:
    """Returns the allowed range as text, such as ``" > 0 and <= 1"``; an empty text without bounds."""
    parts = [f">{'' if open_below else '='} {low}"] * (low > -inf) + [f"<= {high}"] * (high < inf)
    return " " + " and ".join(parts) if parts else ""


def constant_values(props: mi.Properties, name: str) -> list[float]:
    """Returns the numbers of a parameter that is a number, a colour or a spectrum; no numbers for a texture or None.

    Call this function before the parameter is converted to a texture.
    """
    value = props.get(name)
    if value is None or isinstance(value, mi.Object):
        return []
    if isinstance(value, (str, bool)):
        raise reject(props, name, value, "a number, a colour or a texture")
    return [float(v) for v in getattr(value, "values", value if hasattr(value, "__len__") else [value])]


def for_message(values: list[float]) -> float | list[float]:
    """Returns the numbers of `constant_values` for a message: one number if all are equal, else the list."""
    values = [round(v, 6) for v in values]
    return values[0] if len(set(values)) == 1 else values


def expose(callback: mi.TraversalCallback, flags: mi.ParamFlags | None = None, /, **parameters: Any) -> None:
    """Shows textures and Dr.Jit values to ``mi.traverse`` by name, as differentiable or with other ``flags``.

    The function ignores None, strings and plain numbers, including the numbers of scalar variants, which cannot be
    changed in place. If a BSDF exposes a texture with the name ``ambient``, this texture becomes an attribute of the
    BSDF.
    """
    flags = mi.ParamFlags.Differentiable if flags is None else flags
    for name, parameter in parameters.items():
        if parameter is not None and not isinstance(parameter, (float, str)):
            callback.put(name, parameter, flags)


def describe(plugin: mi.Object, **values: Any) -> str:
    """Returns the text of ``to_string``: the class, and one line for each value that is not None."""
    lines = [f"  {name} = {value}".replace("\n", "\n  ") for name, value in values.items() if value is not None]
    return f"{type(plugin).__name__}[\n" + ",\n".join(lines) + "\n]"
