"""What the patterns share: where they are looked up, how they are filtered, and a Mitsuba texture's methods.

A pattern is a function of a point, with values in [0, 1], that mixes two textures: ``base`` where it is 0, ``top`` where
it is 1. Its frequencies are limited by averaging over a box, whose width along each axis of the pattern is the pixel's
footprint, where Mitsuba knows it, plus the parameter ``smoothing``.
"""

import drjit as dr
import mitsuba as mi

from ..parameters import reject

# Edges are never sharper than this, in periods: less would drown in single precision, and have no derivative.
SHARPEST = 1e-3


def number(props, name, default, low, high=float("inf"), open_below=False):
    """A number from ``low`` to ``high``, as an `mi.Float`; ValueError if it is anything else."""
    value = props.get(name, default)
    if not low <= value <= high or value == float("inf") or (open_below and value == low):
        bounds = (f"> {low}" if open_below else f">= {low}") + (f" and <= {high}" if high < float("inf") else "")
        raise reject(props, name, value, "a number " + bounds)
    return mi.Float(value)


def read_space(texture, props):
    """Sets the attributes ``solid``, ``to_local`` and ``smoothing`` of a plugin."""
    texture.solid = props.get("solid", False)
    texture.to_local = mi.AffineTransform4f(props.get("to_local", mi.ScalarTransform4f()).matrix)
    texture.smoothing = number(props, "smoothing", 0.0, 0)
    dr.make_opaque(texture.to_local)


def lookup(texture, si):
    """Point of the pattern's space at ``si``, and the widths of the box over which it is to be averaged."""
    if texture.solid:
        p = si.p
        dx = si.dp_du * si.duv_dx.x + si.dp_dv * si.duv_dx.y
        dy = si.dp_du * si.duv_dy.x + si.dp_dv * si.duv_dy.y
    else:
        p = mi.Point3f(si.uv.x, si.uv.y, 0)
        dx, dy = mi.Vector3f(si.duv_dx.x, si.duv_dx.y, 0), mi.Vector3f(si.duv_dy.x, si.duv_dy.y, 0)
    to_local = texture.to_local
    return to_local @ p, dr.abs(to_local @ dx) + dr.abs(to_local @ dy) + texture.smoothing


def square_wave(x, duty, width):
    """The wave of period 1 that is 1 for |x| <= duty / 2 and 0 elsewhere, averaged over a box of ``width`` around x."""
    width = dr.maximum(width, SHARPEST)
    x = x + 0.5
    x -= dr.floor(x)
    low = 0.5 - duty / 2

    def integral(x):
        whole = dr.floor(x)
        return whole * duty + dr.clip(x - whole - low, 0, duty)

    # A box narrower than a band and than a gap meets one edge at most; then nothing is lost to rounding.
    narrow = dr.clip((duty / 2 - dr.abs(x - 0.5)) / width + 0.5, 0, 1)
    wide = dr.clip((integral(x + width / 2) - integral(x - width / 2)) / width, 0, 1)
    return dr.select(width < dr.minimum(duty, 1 - duty), narrow, wide)


def traverse(texture, callback, textures, numbers):
    """Shows a pattern's parameters to ``mi.traverse``; not the plain numbers of scalar variants, which cannot be changed
    in place."""
    for name in textures:
        callback.put(name, getattr(texture, name), mi.ParamFlags.Differentiable)
    for name in ("to_local", *numbers, "smoothing"):
        value = getattr(texture, name)
        if not isinstance(value, float):
            callback.put(name, value, mi.ParamFlags.Differentiable)


def describe(texture, textures, numbers):
    """The text of ``to_string``."""
    names = (*textures, *numbers, "solid", "to_local", "smoothing")
    lines = [f"  {name} = {getattr(texture, name)}".replace("\n", "\n  ") for name in names]
    return f"{type(texture).__name__}[\n" + ",\n".join(lines) + "\n]"


def pattern(base, top, numbers=()):
    """Class decorator: gives a `mi.Texture` that has ``value(si)``, the pattern, and ``average()``, its mean, the other
    methods of a texture; ``base``, ``top`` and ``numbers`` name its attributes."""

    def eval_by(method):
        def evaluate(self, si, active=True):
            low, high = getattr(self, base), getattr(self, top)
            return dr.lerp(getattr(low, method)(si, active), getattr(high, method)(si, active), self.value(si))
        return evaluate

    def eval_1_grad(self, si, active=True):
        """By central differences, as nested textures may be anything; for bump maps."""
        gradient = []
        for du, dv in ((self.STEP, 0), (0, self.STEP)):
            sides = []
            for sign in (-1, 1):
                moved = mi.SurfaceInteraction3f(si)
                moved.uv = si.uv + sign * mi.Vector2f(du, dv)
                moved.p = si.p + sign * (si.dp_du * du + si.dp_dv * dv)
                sides.append(self.eval_1(moved, active))
            gradient.append((sides[1] - sides[0]) / (2 * self.STEP))
        return mi.Vector2f(*gradient)

    def add_methods(cls):
        cls.STEP = 1e-3
        cls.eval, cls.eval_1, cls.eval_3 = eval_by("eval"), eval_by("eval_1"), eval_by("eval_3")
        cls.eval_1_grad = eval_1_grad
        cls.mean = lambda self: dr.lerp(getattr(self, base).mean(), getattr(self, top).mean(), self.average())
        cls.max = lambda self: max(getattr(self, base).max(), getattr(self, top).max())
        cls.is_spatially_varying = lambda self: True
        cls.traverse = lambda self, callback: traverse(self, callback, (base, top), numbers)
        cls.parameters_changed = lambda self, keys: dr.make_opaque(
            self.to_local, self.smoothing, *(getattr(self, name) for name in numbers))
        cls.to_string = lambda self: describe(self, (base, top), numbers)
        return cls

    return add_methods
