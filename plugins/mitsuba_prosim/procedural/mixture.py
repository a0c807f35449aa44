"""The base class of textures that mix two other textures by a pattern.

A pattern is a function, with values in [0, 1], of the surface parameters (u, v) or of a point in space. To avoid
aliasing, it is averaged over a box, whose width along each axis is that of the pixel's footprint, if ray differentials
exist, plus the parameter ``smoothing``.

Like the modules of plugins, this module is executed again after each change of Mitsuba's variant (see ``registry``).
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..parameters import describe, expose, flag, number


class Mixture(mi.Texture):
    """A texture that is the texture ``BASE`` where its pattern is 0, and the texture ``TOP`` where its pattern is 1.

    A subclass sets ``BASE``, ``TOP``, ``NUMBERS`` and the attributes that ``NUMBERS`` lists, calls `parameters_changed`
    at the end of its ``__init__``, and defines `value` and `average`. The class is not an abstract class of Python's
    module ``abc``, because Mitsuba's classes have another metaclass.
    """

    BASE: tuple[str, float]  #: name of the texture where the pattern is 0, and its default
    TOP: tuple[str, float]  #: name of the texture where the pattern is 1, and its default
    NUMBERS: tuple[str, ...] = ()  #: names of the attributes that are the pattern's own parameters
    STEP = 1e-3  #: step of the differences in `eval_1_grad`, in units of (u, v)

    def __init__(self, props: mi.Properties) -> None:
        """Reads both textures, ``solid``, ``to_local`` and ``smoothing``."""
        super().__init__(props)
        self.base, self.top = (props.get_texture(*part) for part in (self.BASE, self.TOP))
        self.solid = flag(props, "solid")
        self.to_local = mi.AffineTransform4f(props.get("to_local", mi.ScalarTransform4f()).matrix)
        self.smoothing = mi.Float(number(props, "smoothing", 0.0, 0))

    # A subclass defines the next two methods. Mitsuba's classes cannot be abstract by abc: their metaclass is another.

    def value(self, si: mi.SurfaceInteraction3f) -> mi.Float:
        """Returns the value of the pattern at ``si``, in [0, 1]."""
        raise NotImplementedError

    def average(self) -> mi.Float:
        """Returns the mean of the pattern over all points."""
        raise NotImplementedError

    def lookup(self, si: mi.SurfaceInteraction3f) -> tuple[mi.Point3f, mi.Vector3f]:
        """Returns the point of the pattern that belongs to ``si``, and the widths of the box over which the pattern is
        averaged, both in the space of the pattern: (u, v), or the position if ``solid``, transformed by ``to_local``.

        The box contains the pixel's footprint, enlarged by ``smoothing`` along each axis. Without ray differentials,
        the footprint is a point.
        """
        if self.solid:
            p = si.p
            dx = si.dp_du * si.duv_dx.x + si.dp_dv * si.duv_dx.y
            dy = si.dp_du * si.duv_dy.x + si.dp_dv * si.duv_dy.y
        else:
            p = mi.Point3f(si.uv.x, si.uv.y, 0)
            dx, dy = mi.Vector3f(si.duv_dx.x, si.duv_dx.y, 0), mi.Vector3f(si.duv_dy.x, si.duv_dy.y, 0)
        return self.to_local @ p, dr.abs(self.to_local @ dx) + dr.abs(self.to_local @ dy) + self.smoothing

    def eval(self, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.UnpolarizedSpectrum:
        return dr.lerp(self.base.eval(si, active), self.top.eval(si, active), self.value(si))

    def eval_1(self, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.Float:
        return dr.lerp(self.base.eval_1(si, active), self.top.eval_1(si, active), self.value(si))

    def eval_3(self, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.Color3f:
        return dr.lerp(self.base.eval_3(si, active), self.top.eval_3(si, active), self.value(si))

    def eval_1_grad(self, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.Vector2f:
        """Returns the derivatives of the texture by u and v, for bump maps, as central differences."""
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

    def mean(self) -> mi.Float:
        return dr.lerp(self.base.mean(), self.top.mean(), self.average())

    def max(self) -> float:
        return max(self.base.max(), self.top.max())

    def is_spatially_varying(self) -> bool:
        return True

    def parameters(self, *names: str) -> dict[str, Any]:
        """Returns the attributes ``names`` and those that every `Mixture` has: name -> value."""
        own = {name: getattr(self, name) for name in (*names, "to_local", "smoothing")}
        return {self.BASE[0]: self.base, self.TOP[0]: self.top, **own}

    def traverse(self, callback: mi.TraversalCallback) -> None:
        expose(callback, **self.parameters(*self.NUMBERS))

    def parameters_changed(self, keys: list[str]) -> None:
        dr.make_opaque(self.to_local, self.smoothing, *(getattr(self, name) for name in self.NUMBERS))

    def to_string(self) -> str:
        return describe(self, **self.parameters(*self.NUMBERS, "solid"))
