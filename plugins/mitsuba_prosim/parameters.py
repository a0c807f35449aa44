"""Reads the parameters of plugins, rejects wrong values, and shows parameters to ``mi.traverse`` and ``str``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from math import inf, isfinite
from numbers import Real
from typing import Any

import drjit as dr
import mitsuba as mi

from .compat import description

#: Greatest seed and number of samples.
MOST = (1 << 32) - 1


def reject(props: mi.Properties, name: str, value: Any, allowed: str) -> ValueError:
    """Returns the ValueError for a plugin parameter whose ``value`` is not allowed, or missing (None). ``allowed`` are
    words such as ``"a number >= 0"``.
    """
    where = f'"{props.id()}" ({props.plugin_name()})' if props.id() else props.plugin_name()
    found = "missing" if value is None else repr(value)
    return ValueError(f'{where}: parameter "{name}" is {found}; allowed: {allowed}.')


def number(
    props: mi.Properties, name: str, default: float | None, low: float, high: float = inf, open_below: bool = False
) -> float:
    """Reads the parameter ``name``, a finite number from ``low`` (with ``open_below``, above it) to ``high``.

    If ``default`` is None, the parameter is required. Raises ValueError if the value is not allowed or missing.
    """
    value = props.get(name, default)
    if not _is_number(value) or not low <= value <= high or not isfinite(value) or (open_below and value == low):
        raise reject(props, name, value, "a number" + _bounds(low, high, open_below))
    return float(value)


def whole(props: mi.Properties, name: str, default: int | None, low: int, high: int | None = None) -> int:
    """Reads the parameter ``name``, a whole number from ``low`` to ``high``, as an integer or as a float such as 10.0.

    If ``default`` is None, the parameter is required. Raises ValueError if the value is not allowed or missing.
    """
    value = props.get(name, default)
    top = inf if high is None else high
    if not _is_whole(value, low, top):
        raise reject(props, name, value, "a whole number" + _bounds(low, top, False))
    return int(value)


def choice(props: mi.Properties, name: str, allowed: Sequence[str], default: str | None = None) -> str:
    """Reads ``name``, one of the words ``allowed``, by default the first; raises ValueError for others."""
    value = props.get(name, allowed[0] if default is None else default)
    if not isinstance(value, str) or value not in allowed:
        raise reject(props, name, value, "one of " + ", ".join(allowed) if len(allowed) > 2 else " or ".join(allowed))
    return value


def text(props: mi.Properties, name: str, default: str = "") -> str:
    """Reads the parameter ``name``, a text. Raises ValueError for other values."""
    value = props.get(name, default)
    if not isinstance(value, str):
        raise reject(props, name, value, "a text")
    return value


def vector(props: mi.Properties, name: str, default: Sequence[float], allowed: str) -> list[float]:
    """Reads the parameter ``name``, three finite numbers. Raises ValueError for other values; ``allowed`` are words."""
    value = props.get(name, default)
    try:
        found = [float(v) for v in value]
    except (TypeError, ValueError):
        found = []
    if len(found) != 3 or isinstance(value, str) or not all(map(isfinite, found)):
        raise reject(props, name, found or value, allowed)
    return found


def flag(props: mi.Properties, name: str, default: bool = False) -> bool:
    """Reads the parameter ``name``, true or false. Raises ValueError for other values."""
    value = props.get(name, default)
    if not isinstance(value, bool):
        raise reject(props, name, value, "true or false")
    return value


def check_unpolarized(name: str) -> None:
    """Raises ValueError in polarised variants; ``name`` is the integrator's."""
    if mi.is_polarized:
        raise ValueError(
            f"{name}: light is unpolarised here (thesis, section 2.2.3); use a variant without 'polarized', "
            "and for Mitsuba's integrators the command mitsuba."
        )


def check_limit(name: str, value: float | None) -> float:
    """Returns the argument ``name`` of a function, a limit; 0 for None and False, without a limit. Raises ValueError
    unless it is a finite number of at least 0.
    """
    if value is None or value is False:
        return 0.0
    if not _is_number(value) or not 0 <= value < inf:
        raise ValueError(f"{name} is {value!r}; allowed: a number > 0")
    return float(value)


def check_whole(name: str, value: int | None) -> int:
    """Returns the argument ``name`` of a function as an integer, 0 for None; raises ValueError unless it is a whole
    number from 0 to 2^32 - 1, such as ``np.int64(4)`` or 4.0.
    """
    if value is None:
        return 0
    if not _is_whole(value, 0, MOST):
        raise ValueError(f"{name} is {value!r}; allowed: a whole number from 0 to {MOST}")
    return int(value)


def check_seed(seed: int | mi.UInt32) -> int | mi.UInt32:
    """Returns ``seed``, an array or a whole number; raises the errors of :func:`check_whole` for another one."""
    return seed if isinstance(seed, dr.ArrayBase) else check_whole("seed", seed)


def check_samples(sensor: mi.Sensor, spp: int) -> int:
    """Returns ``spp`` as an integer. Raises the errors of :func:`check_whole`, and ValueError if ``spp`` and the number
    of samples of the sampler of ``sensor`` are 0.
    """
    if not (found := check_whole("spp", spp)) and not sensor.sampler().sample_count():
        raise ValueError("sample_count = 0 samples per pixel; give 1 or more")
    return found


def pick_sensor(scene: mi.Scene, sensor: int | mi.Sensor) -> mi.Sensor:
    """Returns ``sensor``, or the sensor with this index. The messages begin with those of Mitsuba's own command
    ``mitsuba``.

    Raises TypeError if ``scene`` is not a scene, and ValueError if it has no sensor with this index.
    """
    if not isinstance(scene, mi.Scene):
        raise TypeError("Root element of the input file must be a <scene> tag!")
    if isinstance(sensor, mi.Sensor):
        return sensor
    sensors = scene.sensors()
    if not sensors:
        raise ValueError("No sensor specified for scene; add the element <sensor>, which is the camera.")
    if not _is_whole(sensor, 0, len(sensors) - 1):
        raise ValueError(f"Specified sensor index is out of bounds! The scene has sensors 0 to {len(sensors) - 1}.")
    return sensors[int(sensor)]


def from_text(text: str) -> Any:
    """Returns the value of a parameter of a plugin from its text on a command line: a number, true or false, a colour
    R,G,B, a dictionary in JSON, or else the text itself.
    """
    if text.count(",") == 2 and not text.startswith("{"):
        with suppress(ValueError):
            return {"type": "rgb", "value": [float(part) for part in text.split(",")]}
    for read in json.loads, float:  # JSON has no .5
        with suppress(ValueError):
            if isinstance(found := read(text), (int, float, dict)):
                return found
    return text


def nested_integrator(props: mi.Properties) -> mi.SamplingIntegrator:
    """Returns the integrator that is nested in a plugin. Raises ValueError unless it is the only nested object, and
    takes samples from a sensor.
    """
    children = [child for _, child in props.objects()]
    if len(children) != 1 or not isinstance(children[0], mi.SamplingIntegrator):
        found = ", ".join(child.class_name() for child in children) or "nothing"
        allowed = "one integrator that takes samples from a sensor: path, volpath, direct, aov or prosim, for example"
        raise reject(props, "integrator", found, allowed)
    return children[0]


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)  # also a number of NumPy


def _is_whole(value: Any, low: float, high: float) -> bool:
    return _is_number(value) and low <= value <= high and isfinite(value) and value == int(value)


def _bounds(low: float, high: float, open_below: bool) -> str:
    """Returns the range from ``low`` to ``high`` as text, such as ``" > 0 and <= 1"``; "" for an unlimited range."""
    parts = [f">{'' if open_below else '='} {low}"] * (low > -inf) + [f"<= {high}"] * (high < inf)
    return " " + " and ".join(parts) if parts else ""


def constant_values(props: mi.Properties, name: str) -> list[float]:
    """Returns the numbers of a number, a colour or a spectrum; none for a texture or a missing parameter. Raises
    ValueError for a text or a boolean. Call this before ``props.get_texture``, which converts the parameter.
    """
    value = props.get(name)
    if value is None or isinstance(value, mi.Object):
        return []
    if isinstance(value, (str, bool)):
        raise reject(props, name, value, "a number, a colour or a texture")
    try:
        return [float(v) for v in getattr(value, "values", value if hasattr(value, "__len__") else [value])]
    except TypeError:  # such as an array of Dr.Jit
        raise reject(props, name, value, "a number, a colour or a texture") from None


def for_message(values: list[float]) -> float | list[float]:
    """Returns ``values`` rounded for an error message: one number if all are equal, else the list."""
    values = [round(v, 6) for v in values]
    return values[0] if len(set(values)) == 1 else values


def expose(callback: mi.TraversalCallback, flags: mi.ParamFlags | None = None, /, **parameters: Any) -> None:
    """Shows the textures and Dr.Jit values ``parameters`` of a plugin to ``mi.traverse``, by default as differentiable.

    None, booleans, strings and Python's floats, such as all numbers of scalar variants, cannot be changed in place, and
    are ignored. ``BSDF.eval_attribute`` evaluates an exposed texture by its name, such as ``ambient``.
    """
    flags = mi.ParamFlags.Differentiable if flags is None else flags
    for name, parameter in parameters.items():
        if parameter is not None and not isinstance(parameter, (bool, float, str)):
            callback.put(name, parameter, flags)


def describe(plugin: mi.Object, **values: Any) -> str:
    """Returns the text for ``plugin.to_string``: the class, and one line for each of ``values`` that is not None."""
    texts = {name: description(value) for name, value in values.items() if value is not None}
    lines = [f"  {name} = {text}".replace("\n", "\n  ") for name, text in texts.items()]
    return f"{type(plugin).__name__}[\n" + ",\n".join(lines) + "\n]"
