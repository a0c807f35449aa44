"""An integrator that adds adaptive N-rook sampling (thesis, sections 4.2.1 and 5.3.2) to any other integrator."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..compat import AOV
from ..engine.integrator import ProgressiveIntegrator
from ..optics.nested import parts
from ..parameters import nested_integrator
from ..registry import plugin
from ..sampling.nrook import SamplerPoints
from ..transport.transport import InnerIntegrator
from ..transport.workarounds import warn_of_wrong_derivatives


@plugin("integrator", "prosim_adaptive")
class ProsimAdaptive(ProgressiveIntegrator):
    r"""
    .. _integrator-prosim_adaptive:

    Adaptive sampling of another integrator (:monosp:`prosim_adaptive`)
    -------------------------------------------------------------------

    .. pluginparameters::

     * - (Nested plugin)
       - :paramtype:`integrator`
       - Computes the radiance along a ray: :monosp:`path`, :monosp:`volpath`, :monosp:`direct`, :monosp:`aov`,
         :monosp:`prb`, or any other integrator that takes samples from a sensor

     * - samples, adaptive, threshold, min_passes, max_samples, noise, noise_99, time, jitter, channels, aovs,
         band
       - |int|, |string|, |float|
       - As for :ref:`integrator-prosim`

    Takes more samples where the image is noisy, up to an error target or a time limit, with the engine of
    :ref:`integrator-prosim`. The expected value is that of the nested integrator. The bits of the image do not depend
    on the crop window, :monosp:`band` and the number of threads. There are two exceptions: with :monosp:`noise` the
    bits depend on the crop window, and with :monosp:`time` the bits depend on the crop window, :monosp:`band` and the
    number of threads. The sensor's sampler is not used.

    Derivatives are those of the nested integrator with uniform sampling. In scalar variants, and within another
    integrator, every pixel gets the samples of the sensor's sampler; the AOVs :monosp:`samples` and
    :monosp:`error` raise an error.

    .. tabs::
        .. code-tab:: xml

            <integrator type="prosim_adaptive">
                <integrator type="path"/>
                <float name="noise" value="0.005"/>
            </integrator>

        .. code-tab:: python

            'type': 'prosim_adaptive',
            'nested': {
                'type': 'path'
            },
            'noise': 0.005
    """

    name = "prosim_adaptive"

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.nested = nested_integrator(props)

    def traverse(self, callback: mi.TraversalCallback) -> None:
        callback.put("nested", self.nested, mi.ParamFlags.Differentiable)

    def parameter_names(self) -> list[str]:
        return ["nested", *super().parameter_names()]

    def aov_names(self) -> list[str]:
        return [*self.nested.aov_names(), *super().aov_names()]

    def render(
        self,
        scene: mi.Scene,
        sensor: int | mi.Sensor = 0,
        seed: int | mi.UInt32 = 0,
        spp: int = 0,
        develop: bool = True,
        evaluate: bool = True,
    ) -> mi.TensorXf:
        """Renders the image, see :meth:`.ProgressiveIntegrator.render`. Around Mitsuba's ``aov``, the result has only
        the channels that ``aov`` returns, in the same order.
        """
        image = super().render(scene, sensor, seed, spp, develop, evaluate)
        if not develop or self.nested.class_name() != AOV:
            return image
        inner = sum(isinstance(part, mi.Integrator) for part in parts(self.nested).values())
        base = image.shape[2] - len(self.aov_names())
        if inner > 1 and base < 3:  # there ``aov`` returns luminances, which the film has not
            return image
        # The film has R, G, B and A of each integrator in ``aov``. The first one's are also the colours of the film.
        ranges = [(base + 4 * k, 2 * base + 4 * k) for k in range(1, inner)] + [(base + 4 * inner, image.shape[2])]
        ranges = [(0, base), *ranges] if inner else ranges
        if not dr.is_jit_v(mi.Float):  # there Dr.Jit cannot concatenate
            import numpy as np  # slow to import

            pixels = np.array(image)
            return mi.TensorXf(np.concatenate([pixels[..., begin:end] for begin, end in ranges], axis=2))
        return dr.concat([image[:, :, begin:end] for begin, end in ranges], axis=2)

    def sample(
        self,
        scene: mi.Scene,
        sampler: mi.Sampler,
        ray: mi.RayDifferential3f,
        medium: mi.Medium | None = None,
        active: mi.Bool = True,
    ) -> tuple[mi.Spectrum, mi.Bool, list[mi.Float]]:
        """Returns the result of the nested integrator along ``ray``, with the AOVs of both. Raises RuntimeError with
        the AOVs ``samples`` and ``error``, and in spectral and monochromatic variants if ``channels`` omits a colour.
        """
        # ``_scalar`` is the transport object of a render in a scalar variant, otherwise None.
        transport = self._scalar or InnerIntegrator(self.nested, scene, medium)
        L, alpha, others = transport(ray, SamplerPoints(sampler), active)
        return self._stored(L), alpha > 0.5, others + self._aovs_of_ray(scene, sampler, ray, active)

    def transport(self, scene: mi.Scene, sensor: mi.Sensor, attached: bool = False) -> InnerIntegrator:
        return InnerIntegrator(self.nested, scene, sensor.get_medium())

    def _check_derivatives(self, scene: mi.Scene) -> None:
        warn_of_wrong_derivatives(scene)
        if self.omits_colours:
            raise RuntimeError(f'{self.name}: derivatives are of all colours; leave out channels = "{self.channels}".')

    def render_forward(
        self, scene: mi.Scene, params: Any, sensor: int | mi.Sensor = 0, seed: int | mi.UInt32 = 0, spp: int = 0
    ) -> mi.TensorXf:
        """Returns the forward-mode derivative of the image by the nested integrator; 0 for the AOVs that this
        integrator adds. If ``spp`` is 0, each pixel gets N² samples, where N is the parameter ``samples``. Raises
        RuntimeError if ``channels`` omits a colour.
        """
        self._check_derivatives(scene)
        gradient = self.nested.render_forward(scene, params, sensor, seed, spp or self.samples**2)
        own = len(self.aov_names()) - len(self.nested.aov_names())  # further channels, which have no derivatives
        return dr.concat((gradient, dr.zeros(mi.TensorXf, (*gradient.shape[:2], own))), axis=2) if own else gradient

    def render_backward(
        self,
        scene: mi.Scene,
        params: Any,
        grad_in: mi.TensorXf,
        sensor: int | mi.Sensor = 0,
        seed: int | mi.UInt32 = 0,
        spp: int = 0,
    ) -> None:
        """Backpropagates the gradient ``grad_in`` of the image, except for the AOVs that this integrator adds, by the
        nested integrator. Otherwise as :meth:`render_forward`.
        """
        self._check_derivatives(scene)
        own = len(self.aov_names()) - len(self.nested.aov_names())
        grad_in = grad_in[:, :, : grad_in.shape[2] - own]
        self.nested.render_backward(scene, params, grad_in, sensor, seed, spp or self.samples**2)
