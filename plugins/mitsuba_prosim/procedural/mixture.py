"""The base class of textures that mix two others by a pattern.

A pattern is a function of a point, with values in [0, 1]. It is looked up on the surface or in space. Its frequencies
are limited by averaging over a box, whose width along each axis of the pattern is the pixel's footprint, where Mitsuba
knows it, plus the parameter ``smoothing``.

Like the plugins, this module runs again when the variant changes (see ``registry``).
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..parameters import describe, expose, number


class Mixture(mi.Texture):
    """A texture that is the texture ``BASE`` where its pattern is 0, and ``TOP`` where it is 1.

    A subclass sets the names below and the attributes of ``NUMBERS``, calls `parameters_changed` at the end of its
    ``__init__``, and defines `value` and `average`. (Classes of Mitsuba's cannot be abstract
    by ``abc``: their metaclass is another.)
    """

    BASE: tuple[str, float]  #: name of the texture where the pattern is 0, and its default
    TOP: tuple[str, float]  #: ... where it is 1
    NUMBERS: tuple[str, ...] = ()  #: names of the attributes that are the pattern's own parameters
    STEP = 1e-3  #: of the differences that `eval_1_grad` takes, in units of (u, v)

    def __init__(self, props: mi.Properties) -> None:
        """Reads both textures, ``solid``, ``to_local`` and ``smoothing``."""
        super().__init__(props)
        self.base, self.top = (props.get_texture(*part) for part in (self.BASE, self.TOP))
        self.solid = props.get("solid", False)
        self.to_local = mi.AffineTransform4f(props.get("to_local", mi.ScalarTransform4f()).matrix)
        self.smoothing = mi.Float(number(props, "smoothing", 0.0, 0))

    # A subclass defines the next two. Mitsuba's classes cannot be abstract by abc: their metaclass is another.

    def value(self, si: mi.SurfaceInteraction3f) -> mi.Float:
        """The pattern at ``si``, in [0, 1]."""
        raise NotImplementedError

    def average(self) -> mi.Float:
        """Mean of the pattern over all of its space."""
        raise NotImplementedError

    def lookup(self, si: mi.SurfaceInteraction3f) -> tuple[mi.Point3f, mi.Vector3f]:
        """The uv (or the position, if ``solid``) in the pattern's space, and the widths of the box to average over."""
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

    def mean(self) -> mi.Float:
        return dr.lerp(self.base.mean(), self.top.mean(), self.average())

    def max(self) -> float:
        return max(self.base.max(), self.top.max())

    def is_spatially_varying(self) -> bool:
        return True

    def parameters(self, *names: str) -> dict[str, Any]:
        """The attributes of these names, with those that every mixture has."""
        own = {name: getattr(self, name) for name in (*names, "to_local", "smoothing")}
        return {self.BASE[0]: self.base, self.TOP[0]: self.top, **own}

    def traverse(self, callback: mi.TraversalCallback) -> None:
        expose(callback, **self.parameters(*self.NUMBERS))

    def parameters_changed(self, keys: list[str]) -> None:
        dr.make_opaque(self.to_local, self.smoothing, *(getattr(self, name) for name in self.NUMBERS))

    def to_string(self) -> str:
        return describe(self, **self.parameters(*self.NUMBERS, "solid"))
