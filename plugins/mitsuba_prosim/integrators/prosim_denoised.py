"""An integrator whose image is the denoised image of another integrator."""

from __future__ import annotations

from typing import Any, NoReturn

import drjit as dr
import mitsuba as mi

from ..alone import alone
from ..parameters import describe, flag, nested_integrator, reject
from ..registry import plugin

#: The further channels of the denoised image, see :meth:`.FinalImage.channels`.
COLOURS = [f"{layer}.{colour}" for layer in ("raw", "denoised") for colour in "RGB"]
LAYERS = (*COLOURS, "error.Y", "error_raw.Y", "error_denoised.Y")


@plugin("integrator", "prosim_denoised")
class ProsimDenoised(mi.SamplingIntegrator):
    r"""
    .. _integrator-prosim_denoised:

    The denoised image of another integrator (:monosp:`prosim_denoised`)
    --------------------------------------------------------------------

    .. pluginparameters::

     * - (Nested plugin)
       - :paramtype:`integrator`
       - Renders the image: :monosp:`prosim`, :monosp:`prosim_adaptive`, or an integrator of Mitsuba that takes samples
         from a sensor

     * - fast
       - |bool|
       - Use smaller networks, which are several times faster (Default: |true| if an image has less than about 2400 rays
         per pixel)

    Renders two halves of the samples and applies Open Image Denoise as far as the halves agree (:doc:`/denoising`).
    Further channels are the :monosp:`raw` and the :monosp:`denoised` image, and the estimated standard errors
    :monosp:`error`, :monosp:`error_raw` and :monosp:`error_denoised` of the final, the raw and the denoised image. The
    parameter :monosp:`noise` of the nested integrator limits the error of the final image. The parameter :monosp:`time`
    limits the time including the denoiser.

    This integrator has no derivatives (use those of the nested integrator), and cannot be nested in another integrator.
    This integrator needs the package :monosp:`mitsuba-oidn`, which the extra :monosp:`denoise` installs.

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

    name = "prosim_denoised"

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.fast = flag(props, "fast") if "fast" in props else None
        self.nested = nested_integrator(props)
        if type(self.nested) is type(self):
            raise reject(props, "integrator", self.nested.class_name(), "prosim or path, for example")

    def traverse(self, callback: mi.TraversalCallback) -> None:
        callback.put("nested", self.nested, mi.ParamFlags.Differentiable)

    def aov_names(self) -> list[str]:
        return [*self.nested.aov_names(), *LAYERS]

    def cancel(self) -> None:
        """Ends the render in progress, which denoises the samples so far, or raises RuntimeError if a pixel has no
        sample of the second half yet.
        """
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
        """Renders and denoises the image, stores it in the film, and returns the developed film; an empty tensor if
        ``develop`` is false. ``evaluate`` is ignored.

        The ``spp`` samples per pixel (0: about as many as those of the nested integrator alone) are divided between two
        images for the denoiser.
        """
        # Imported for the first image: few users denoise, and the denoiser is slow to load.
        from ..denoising.final_image import denoised_progressive

        seed = int(dr.slice(seed, 0)) if isinstance(seed, dr.ArrayBase) else seed
        final = denoised_progressive(scene, sensor, self.nested, seed, spp, self.fast)
        final.render.run()
        with alone():  # all renders share the film
            final.update_film(self.aov_names())
            return final.denoiser.sensor.film().develop() if develop else mi.TensorXf()

    def sample(self, *_: Any, **__: Any) -> NoReturn:
        """Raises RuntimeError, because the denoiser needs the whole image, not a single ray."""
        raise RuntimeError(
            "prosim_denoised: the denoiser needs all pixels at once, so this integrator can't be nested in another "
            "integrator; nest the other integrator in prosim_denoised."
        )

    def render_forward(self, *_: Any, **__: Any) -> NoReturn:
        raise RuntimeError("prosim_denoised: a denoised image has no derivatives; take those of the nested integrator.")

    render_backward = render_forward
