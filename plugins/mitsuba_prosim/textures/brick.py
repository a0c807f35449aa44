"""Brickwork: prosim_brick (t-tijolo)."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..parameters import number
from ..procedural.mixture import Mixture
from ..procedural.patterns import square_wave
from ..registry import plugin


@plugin("texture", "prosim_brick")
class Brick(Mixture):
    r"""
    .. _texture-prosim_brick:

    Brickwork (:monosp:`prosim_brick`)
    ----------------------------------

    .. pluginparameters::

     * - brick, mortar
       - |spectrum| or |texture|
       - The two colours. (Default: 0.4 and 0.2)
       - |exposed|, |differentiable|

     * - brick_width, brick_height
       - |float|
       - Size of a brick without mortar, > 0. (Default: 0.23 and 0.07)
       - |exposed|, |differentiable|

     * - mortar_width
       - |float|
       - Width of the joints, >= 0. (Default: 0.01)
       - |exposed|, |differentiable|

     * - stagger
       - |float|
       - Shift of each row relative to the row below, in bricks. (Default: 0.5)
       - |exposed|

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

    The texture :monosp:`t-tijolo` of the thesis's example scene. The rows of bricks run along x (or u), one above the
    other along y (or v). On (u, v) the origin is the middle of a joint, so that a whole number of bricks closes without
    a seam. In a solid, the depth of a brick along z is its width. There the origin is the middle of a brick, so that a
    face through the origin does not run along a joint. With ray differentials, the edges are averaged analytically over
    the pixel's footprint.

    .. tabs::
        .. code-tab:: xml

            <texture type="prosim_brick">
                <rgb name="brick" value="0.5, 0.2, 0.12"/>
                <rgb name="mortar" value="0.6, 0.58, 0.54"/>
                <float name="brick_width" value="0.24"/>
                <float name="brick_height" value="0.09"/>
                <float name="mortar_width" value="0.01"/>
            </texture>

        .. code-tab:: python

            'type': 'prosim_brick',
            'brick': {
                'type': 'rgb',
                'value': [0.5, 0.2, 0.12]
            },
            'mortar': {
                'type': 'rgb',
                'value': [0.6, 0.58, 0.54]
            },
            'brick_width': 0.24,
            'brick_height': 0.09,
            'mortar_width': 0.01
    """

    BASE, TOP = ("mortar", 0.2), ("brick", 0.4)
    NUMBERS = ("brick_width", "brick_height", "mortar_width", "stagger")

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.brick_width = mi.Float(number(props, "brick_width", 0.23, 0, open_below=True))
        self.brick_height = mi.Float(number(props, "brick_height", 0.07, 0, open_below=True))
        self.mortar_width = mi.Float(number(props, "mortar_width", 0.01, 0))
        self.stagger = mi.Float(number(props, "stagger", 0.5, 0))
        self.parameters_changed([])

    def value(self, si: mi.SurfaceInteraction3f) -> mi.Float:
        """Returns the fraction of brick at ``si``: 1 in a brick, 0 in the mortar, between at a smoothed edge."""
        p, width = self.lookup(si)
        pitch_x, pitch_y = self.brick_width + self.mortar_width, self.brick_height + self.mortar_width
        # The fractions of a period that are brick.
        duty_x, duty_y = self.brick_width / pitch_x, self.brick_height / pitch_y
        # The origin is the middle of a brick in a solid, and the middle of a joint on (u, v).
        origin = 0 if self.solid else 0.5
        y = p.y / pitch_y - origin
        shift = dr.floor(y + 0.5) * self.stagger  # number of the row, times the shift from row to row
        value = square_wave(y, duty_y, width.y / pitch_y)
        value *= square_wave(p.x / pitch_x - origin - shift, duty_x, width.x / pitch_x)
        if self.solid:
            value *= square_wave(p.z / pitch_x, duty_x, width.z / pitch_x)
        return value

    def average(self) -> mi.Float:
        """Returns the mean of the pattern: the fraction of the area, or of the volume of a solid, that is brick."""
        columns = self.brick_width / (self.brick_width + self.mortar_width)
        rows = self.brick_height / (self.brick_height + self.mortar_width)
        return rows * columns * (columns if self.solid else 1)
