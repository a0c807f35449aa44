"""Random inputs of tests, and what a plugin returns as arrays."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np


def uniform(n: int, dimensions: int, seed: int = 1) -> np.ndarray:
    """Returns uniform numbers in [0, 1), shape (dimensions, n), in single precision."""
    return np.random.default_rng(seed).random((dimensions, n), dtype=np.float32)


def directions(n: int, seed: int) -> np.ndarray:
    """Returns unit vectors, shape (3, n): uniform on the sphere; every eighth is near the horizon."""
    u, v = uniform(n, 2, seed + 1000)
    z = 2 * u - 1
    z[::8] *= 0.02
    r, phi = np.sqrt(1 - z * z), 2 * np.pi * v
    return np.stack([r * np.cos(phi), r * np.sin(phi), z]).astype(np.float32)


def rows(value: Any, n: int | None = None, whole: bool = False) -> np.ndarray:
    """Returns a number, a vector or a spectrum as an array of shape (components, n); of a Mueller matrix only its first
    element, unless it is to be ``whole``.
    """
    if dr.is_matrix_v(value):
        value = np.array(value).reshape(-1, dr.width(value)) if whole else mi.unpolarized_spectrum(value)
    array = np.array(value, dtype=float)
    array = array.reshape(-1, 1) if dr.is_array_v(value) and not dr.is_jit_v(value) else np.atleast_2d(array)
    return array if n is None else np.broadcast_to(array, (array.shape[0], n))


def rows_of(values: Iterable[Any], n: int | None = None) -> list[np.ndarray]:
    """Returns the :func:`rows` of several values, which one kernel computes: compiling takes most of a test's time."""
    values = tuple(values)
    dr.eval(values)
    return [rows(value, n) for value in values]


def slopes(f: Callable[[Any], Any], x: np.ndarray, h: float) -> list[np.ndarray]:
    """Returns the differences of ``f`` by both coordinates of the places ``x``, shape (2, n)."""
    ends = [[mi.Point2f((x + side * h * axis[:, None]).astype(np.float32)) for side in (1, -1)] for axis in np.eye(2)]
    return [np.subtract(*rows_of(map(f, pair))) / (2 * h) for pair in ends]


def described(where: str | Mapping[str, Any], i: int = 0) -> str:
    """Describes column i of each named array in words: the angles of a unit vector, else the numbers."""
    texts = []
    for name, value in {where: ()}.items() if isinstance(where, str) else where.items():
        v = rows(value)[:, i] if np.size(value) else np.zeros(0)
        numbers = f"({', '.join(f'{x:.4g}' for x in v)})" if len(v) > 1 else f"{v[0]:.4g}" if len(v) else ""
        if len(v) == 3 and abs(np.linalg.norm(v) - 1) < 1e-3:
            theta, phi = np.degrees([np.arccos(np.clip(v[2], -1, 1)), np.arctan2(v[1], v[0])])
            numbers = f"{theta:.1f}° azimuth {phi % 360:.0f}°"
        texts.append(f"{name} {numbers}".strip())
    return ", ".join(filter(None, texts))


def to_drjit(values: np.ndarray) -> Any:
    """Returns one, two or three rows of numbers, or numbers of scalar variants, as Mitsuba's type."""
    kind = {1: mi.Float, 2: mi.Point2f, 3: mi.Vector3f}[len(values)]
    return kind(*values)


def interaction(kind: Any, n: int, wavelengths: Any = None, /, **fields: Any) -> Any:
    """Returns ``n`` interactions of Mitsuba's type ``kind`` with these ``fields``; ``wavelengths`` has a default."""
    found = dr.zeros(kind, n)
    if mi.is_spectral:
        found.wavelengths = mi.UnpolarizedSpectrum(450, 520, 590, 650) if wavelengths is None else wavelengths
    for name, value in fields.items():
        setattr(found, name, value)
    return found


def surface(wi: Any, uv: Any, n: int | None = None, wavelengths: Any = None) -> Any:
    """Returns points of a surface that are seen from the local directions ``wi``."""
    wi, uv, u, v = mi.Vector3f(wi), mi.Point2f(uv), mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
    frame, n = mi.Frame3f(u, v, mi.Vector3f(0, 0, 1)), n or dr.width(wi)
    fields = {"uv": uv, "t": mi.Float(1), "n": frame.n, "sh_frame": frame, "dp_du": u, "dp_dv": v}
    fields |= {"wi": wi + dr.zeros(mi.Vector3f, n), "p": mi.Point3f(uv.x, uv.y, 0)}
    return interaction(mi.SurfaceInteraction3f, n, wavelengths, **fields)


def octant(p: np.ndarray) -> np.ndarray:
    """Returns the number of the octant of each vector, from 0 to 7."""
    return ((p > 0) * [[1], [2], [4]]).sum(axis=0)


def lit(spectrum: Any) -> Any:
    """Whether a spectrum is above 0 in any channel."""
    return dr.any(mi.unpolarized_spectrum(spectrum) > 0)


def contexts(plugin: Any, kind: Any) -> Iterator[tuple[str, Any, int]]:
    """Yields the name, the context of the type ``kind``, and the flags of the whole plugin, and of each component."""
    yield "", kind(), plugin.flags()
    for i in range(plugin.component_count() if plugin.component_count() > 1 else 0):
        ctx = kind()
        ctx.component = i
        yield f"component {i}, ", ctx, plugin.flags(i)
