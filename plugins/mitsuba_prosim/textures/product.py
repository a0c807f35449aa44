"""Product of two textures: prosim_product."""

from __future__ import annotations

import mitsuba as mi

from ..parameters import describe, expose
from ..registry import plugin


@plugin("texture", "prosim_product")
class Product(mi.Texture):
    r"""
    .. _texture-prosim_product:

    Product of textures (:monosp:`prosim_product`)
    ----------------------------------------------

    .. pluginparameters::

     * - a, b
       - |spectrum| or |texture|
       - The factors. (Default: 1)
       - |exposed|, |differentiable|

    Multiplies two textures: for example, an image on the surface with the colour of the material. The method ``mean``
    returns the product of the two means, which is exact only for uncorrelated textures.

    .. tabs::
        .. code-tab:: xml

            <texture type="prosim_product">
                <rgb name="a" value="0.5, 0.4, 0.2"/>
                <texture name="b" type="prosim_stripes">
                    <float name="frequency" value="8"/>
                </texture>
            </texture>

        .. code-tab:: python

            'type': 'prosim_product',
            'a': {
                'type': 'rgb',
                'value': [0.5, 0.4, 0.2]
            },
            'b': {
                'type': 'prosim_stripes',
                'frequency': 8
            }
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.a = props.get_texture("a", 1.0)
        self.b = props.get_texture("b", 1.0)

    def traverse(self, callback: mi.TraversalCallback) -> None:
        expose(callback, a=self.a, b=self.b)

    def eval(self, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.UnpolarizedSpectrum:
        return self.a.eval(si, active) * self.b.eval(si, active)

    def eval_1(self, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.Float:
        return self.a.eval_1(si, active) * self.b.eval_1(si, active)

    def eval_3(self, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.Color3f:
        return self.a.eval_3(si, active) * self.b.eval_3(si, active)

    def eval_1_grad(self, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.Vector2f:
        a, b = self.a.eval_1(si, active), self.b.eval_1(si, active)
        return self.a.eval_1_grad(si, active) * b + self.b.eval_1_grad(si, active) * a

    def mean(self) -> mi.Float:
        return self.a.mean() * self.b.mean()

    def max(self) -> float:
        return self.a.max() * self.b.max()

    def is_spatially_varying(self) -> bool:
        return self.a.is_spatially_varying() or self.b.is_spatially_varying()

    def to_string(self) -> str:
        return describe(self, a=self.a, b=self.b)
