"""A constant sky: a sphere around everything, sampled by projected solid angle."""

from __future__ import annotations

import mitsuba as mi

from .sample import LightSample, direction_sample, weighed


class Sky:
    """Mitsuba's ``constant``. ``far``: a distance beyond the scene."""

    #: Whether all of it is sampled: only what is above the horizon.
    whole_sphere = False

    def __init__(self, far: float) -> None:
        self.far = far

    @staticmethod
    def takes(emitter: mi.Emitter | mi.EmitterPtr) -> bool:
        """Whether ``emitter`` is a constant sky."""
        return emitter.class_name() == "ConstantBackgroundEmitter"

    def sample(
        self,
        emitter: mi.Emitter | mi.EmitterPtr,
        si: mi.SurfaceInteraction3f,
        n: mi.Normal3f,
        sample: mi.Point2f,
        active: mi.Bool,
    ) -> LightSample:
        """A point of the sky above the horizon of ``n``; see :meth:`.balls.Balls.sample`."""
        local = mi.warp.square_to_cosine_hemisphere(sample)
        ds = direction_sample(si, mi.Frame3f(n).to_world(local))
        ds.dist = mi.Float(self.far)
        ds.p, ds.n, ds.pdf = si.p + ds.d * self.far, -ds.d, mi.warp.square_to_cosine_hemisphere_pdf(local)
        return weighed(emitter, si, ds, active)
