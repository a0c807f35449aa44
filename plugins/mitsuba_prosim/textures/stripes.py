"""Stripes: prosim_stripes (t-listra)."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..parameters import number, reject
from ..procedural.mixture import Mixture
from ..procedural.patterns import square_wave
from ..registry import plugin


@plugin("texture", "prosim_stripes")
class Stripes(Mixture):
    r"""
    .. _texture-prosim_stripes:

    Stripes (:monosp:`prosim_stripes`)
    ----------------------------------

    .. pluginparameters::

     * - color0, color1
       - |spectrum| or |texture|
       - The two colours of the stripes. (Default: 0.4 and 0.2)
       - |exposed|, |differentiable|

     * - frequency
       - |float|
       - Pairs of stripes per unit of length, > 0. (Default: 5)
       - |exposed|, |differentiable|

     * - duty
       - |float|
       - Fraction of the width that has ``color0``, in [0, 1]. (Default: 0.5)
       - |exposed|, |differentiable|

     * - axis
       - |vector|
       - Direction across the stripes, of any length; on (u, v) its first two components count. (Default: 1, 0, 0)
       - |exposed|, |differentiable|

     * - solid
       - |bool|
       - Whether the pattern is a function of the point in space, instead of the surface parameters (u, v).
         (Default: false)

     * - to_local
       - |transform|
       - From (u, v), or from world space if ``solid``, to the space of the pattern. (Default: none)
       - |exposed|, |differentiable|

     * - smoothing
       - |float|
       - Width over which the pattern is averaged along each of its axes, >= 0. Only averaged edges have derivatives by
         the sizes, so these are noisy if it is 0. (Default: 0)
       - |exposed|, |differentiable|

    The texture :monosp:`t-listra` of the thesis's example scene. The origin is the middle of a stripe of ``color0``. So
    a whole number of pairs closes without a seam where u goes from 1 to 0, and a flat end of a solid does not fall on
    an edge of a stripe. With ray differentials, the edges are averaged analytically over the pixel's footprint.

    .. tabs::
        .. code-tab:: xml

            <texture type="prosim_stripes">
                <rgb name="color0" value="0.8, 0.8, 0.8"/>
                <rgb name="color1" value="0.3, 0.2, 0.6"/>
                <float name="frequency" value="8"/>
            </texture>

        .. code-tab:: python

            'type': 'prosim_stripes',
            'color0': {
                'type': 'rgb',
                'value': [0.8, 0.8, 0.8]
            },
            'color1': {
                'type': 'rgb',
                'value': [0.3, 0.2, 0.6]
            },
            'frequency': 8
    """

    BASE, TOP = ("color1", 0.2), ("color0", 0.4)
    NUMBERS = ("axis", "frequency", "duty")

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.frequency = mi.Float(number(props, "frequency", 5.0, 0, open_below=True))
        self.duty = mi.Float(number(props, "duty", 0.5, 0, 1))
        axis = mi.ScalarVector3f(props.get("axis", mi.ScalarVector3f(1, 0, 0)))
        if not self.solid:  # the pattern depends on (u, v) alone
            axis.z = 0
        if not 0 < dr.norm(axis) < float("inf"):
            raise reject(props, "axis", list(axis), "a vector of finite length > 0")
        self.axis = mi.Vector3f(axis)
        self.parameters_changed([])

    def value(self, si: mi.SurfaceInteraction3f) -> mi.Float:
        """Returns the fraction of ``color0`` at ``si``: 1 or 0 in a stripe, between at a smoothed edge."""
        p, width = self.lookup(si)
        axis = dr.normalize(self.axis) * self.frequency
        return square_wave(dr.dot(p, axis), self.duty, dr.dot(width, dr.abs(axis)))

    def average(self) -> mi.Float:
        return self.duty
