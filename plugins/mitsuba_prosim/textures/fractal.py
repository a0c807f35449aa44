"""Fractal noise: prosim_fractal (t-fractal)."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..parameters import number, whole
from ..procedural.mixture import Mixture
from ..procedural.patterns import gradient_noise
from ..registry import plugin
from ..sampling.hash import combine


@plugin("texture", "prosim_fractal")
class Fractal(Mixture):
    r"""
    .. _texture-prosim_fractal:

    Fractal noise (:monosp:`prosim_fractal`)
    ----------------------------------------

    .. pluginparameters::

     * - color0, color1
       - |spectrum| or |texture|
       - The two colours that the noise mixes. (Default: 0.4 and 0.2)
       - |exposed|, |differentiable|

     * - scale
       - |float|
       - Features of the coarsest octave per unit of length, > 0. (Default: 4)
       - |exposed|, |differentiable|

     * - octaves
       - |integer|
       - Number of octaves, from 1 to 16. (Default: 6)

     * - gain
       - |float|
       - Ratio of the amplitude of an octave to that of the previous octave, >= 0. (Default: 0.5)
       - |exposed|, |differentiable|

     * - lacunarity
       - |float|
       - Ratio of the frequency of an octave to that of the previous octave, > 0. (Default: 2)
       - |exposed|, |differentiable|

     * - seed
       - |integer|
       - Seed of the noise. (Default: 0)

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
       - Octaves whose features are smaller than about this width fade out. (Default: 0)
       - |exposed|, |differentiable|

    The texture :monosp:`t-fractal` of the thesis's example scene: a sum of octaves of gradient noise (Perlin 1985, with
    the smoother interpolation of 2002). An integer hash, the same on every machine, gives the gradients. Each octave is
    shifted, so that the lattices of the octaves do not coincide. The sum is scaled so that two standard deviations on
    either side of its mean fill the range from ``color0`` to ``color1``, and clipped to this range. Octaves too fine
    for the pixel's footprint fade out if the footprint is known.

    .. tabs::
        .. code-tab:: xml

            <texture type="prosim_fractal">
                <rgb name="color0" value="0.1, 0.3, 0.08"/>
                <rgb name="color1" value="0.35, 0.7, 0.25"/>
                <float name="scale" value="3"/>
                <integer name="octaves" value="5"/>
            </texture>

        .. code-tab:: python

            'type': 'prosim_fractal',
            'color0': {
                'type': 'rgb',
                'value': [0.1, 0.3, 0.08]
            },
            'color1': {
                'type': 'rgb',
                'value': [0.35, 0.7, 0.25]
            },
            'scale': 3,
            'octaves': 5
    """

    BASE, TOP = ("color0", 0.4), ("color1", 0.2)
    NUMBERS = ("scale", "gain", "lacunarity")

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.scale = mi.Float(number(props, "scale", 4.0, 0, open_below=True))
        self.gain = mi.Float(number(props, "gain", 0.5, 0))
        self.lacunarity = mi.Float(number(props, "lacunarity", 2.0, 0, open_below=True))
        self.octaves = whole(props, "octaves", 6, 1, 16)
        self.seed = mi.UInt32(whole(props, "seed", 0, 0, 2**32 - 1))
        dr.make_opaque(self.seed)
        self.parameters_changed([])

    def value(self, si: mi.SurfaceInteraction3f) -> mi.Float:
        """Returns the sum of the octaves of gradient noise at ``si``, scaled and clipped to [0, 1].

        The sum is scaled so that 0 and 1 are two standard deviations from the mean 0.5. Octaves fade out whose features
        are smaller than about the width over which the pattern is averaged (:meth:`.Mixture.lookup`).
        """
        p, width = self.lookup(si)
        width = dr.maximum(dr.maximum(width.x, width.y), width.z)
        frequency, amplitude, total, power = self.scale, mi.Float(1), mi.Float(0), mi.Float(0)
        for octave in range(self.octaves):
            # 1 for features that are at least twice as large as the width, 0 for features smaller than the width.
            visible = dr.clip(2 - 2 * width * frequency, 0, 1)
            # The shift keeps the lattices of the octaves from coinciding.
            q = p * frequency + 0.37 * octave
            coordinates = (q.x, q.y, q.z) if self.solid else (q.x, q.y)
            total += amplitude * visible * gradient_noise(coordinates, combine(self.seed, octave))
            power += dr.square(amplitude)
            frequency = frequency * self.lacunarity
            amplitude = amplitude * self.gain
        deviation = 0.191 if self.solid else 0.177  # standard deviation of one octave, measured by sampling
        return dr.clip(0.5 + total / (4 * deviation * dr.sqrt(power)), 0, 1)

    def average(self) -> mi.Float:
        return mi.Float(0.5)
