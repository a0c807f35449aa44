"""Another integrator's image, denoised, as an integrator."""

from __future__ import annotations

from typing import Any, NoReturn

import drjit as dr
import mitsuba as mi

from ..alone import alone
from ..parameters import describe, nested_integrator, reject
from ..registry import plugin

#: The channels that tell of the denoised image, as :mod:`..denoising.layers` has them.
LAYERS = (
    *(f"{layer}.{colour}" for layer in ("raw", "denoised") for colour in "RGB"),
    *("error.Y", "error_raw.Y", "error_denoised.Y"),
)


@plugin("integrator", "prosim_denoised")
class ProsimDenoised(mi.SamplingIntegrator):
    r"""
    .. _integrator-prosim_denoised:

    The denoised image of another integrator (:monosp:`prosim_denoised`)
    --------------------------------------------------------------------

    .. pluginparameters::

     * - (Nested plugin)
       - :paramtype:`integrator`
       - Renders the image: :monosp:`prosim`, :monosp:`prosim_adaptive`, or one of Mitsuba's that takes samples from a
         sensor

     * - fast
       - |bool|
       - Use smaller networks, which are several times as fast (Default: |false|)

    Renders two halves of the samples and applies Open Image Denoise as far as the halves agree, see :doc:`/denoising`.
    Further channels are the :monosp:`raw` and the :monosp:`denoised` image, and the estimated standard errors
    :monosp:`error`, :monosp:`error_raw` and :monosp:`error_denoised` of the three. :monosp:`noise` of the nested
    integrator is the limit of the final image's error, and :monosp:`time` includes the denoiser's.

    It has no derivatives (use those of the nested integrator) and cannot be nested in another integrator. It needs the
    package :monosp:`mitsuba-oidn`, the extra :monosp:`denoise`.

    .. tabs::
        .. code-tab:: xml

            <integrator type="prosim_denoised">
                <integrator type="prosim">
                    <integer name="samples" value="4"/>
                </integrator>
            </integrator>

        .. code-tab:: python

            'type': 'prosim_denoised',
            'nested': {
                'type': 'prosim',
                'samples': 4
            }
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.fast = props.get("fast", False)
        self.nested = nested_integrator(props)
        if type(self.nested) is type(self):
            raise reject(props, "integrator", self.nested.class_name(), "prosim or path, for example")

    def traverse(self, callback: mi.TraversalCallback) -> None:
        callback.put("nested", self.nested, mi.ParamFlags.Differentiable)

    def aov_names(self) -> list[str]:
        return [*self.nested.aov_names(), *LAYERS]

    def cancel(self) -> None:
        """Ends a render in progress; its image is not denoised."""
        self.nested.cancel()

    def to_string(self) -> str:
        return describe(self, nested=self.nested, fast=self.fast)

    def render(
        self,
        scene: mi.Scene,
        sensor: int | mi.Sensor = 0,
        seed: int | mi.UInt32 = 0,
        spp: int = 0,
        develop: bool = True,
        evaluate: bool = True,
    ) -> mi.TensorXf:
        # Imported for the first image: few users denoise, and the denoiser is slow to load.
        from ..denoising import halves, layers

        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        seed = seed if isinstance(seed, int) else int(dr.slice(seed, 0))
        final = halves.denoised_progressive(scene, sensor, self.nested, seed, spp, self.fast).run().denoiser
        with alone():  # the film is that of all renders
            layers.update_film(final, self.aov_names())
            return sensor.film().develop() if develop else mi.TensorXf()

    def sample(self, *_: Any, **__: Any) -> NoReturn:
        raise RuntimeError(
            "prosim_denoised: a denoised image is one of all of its pixels, so it can't be nested in another "
            "integrator; nest the other in it."
        )

    def render_forward(self, *_: Any, **__: Any) -> NoReturn:
        raise RuntimeError("prosim_denoised: a denoised image has no derivatives; take those of the nested integrator.")

    render_backward = render_forward
