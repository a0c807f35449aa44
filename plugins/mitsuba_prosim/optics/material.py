"""The base class of all materials.

Like the plugins, this module runs again when the variant changes (see ``registry``).
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from ..parameters import describe, expose


class Material(mi.BSDF):
    """A BSDF that a subclass defines by ``sample``, ``eval_pdf`` and the names of its parameters.

    (Classes of Mitsuba's cannot be abstract by ``abc``: their metaclass is another.)
    """

    #: Names of the attributes that ``mi.traverse`` shows: textures and Dr.Jit values; further ones for ``to_string``.
    EXPOSED: tuple[str, ...] = ()
    SHOWN: tuple[str, ...] = ()
    #: The :class:`.Distribution` of its microfacets, and the texture of their roughness; None if it has no such facets.
    distribution: Any = None
    roughness: Any = None

    def parameters(self) -> dict[str, Any]:
        """The textures and Dr.Jit values that ``mi.traverse`` shows, by name."""
        own = {name: getattr(self, name) for name in self.EXPOSED}
        return own if self.distribution is None else {**own, self.distribution.parameter: self.roughness}

    def settings(self) -> dict[str, Any]:
        """Further values for ``to_string``."""
        own = {name: getattr(self, name) for name in self.SHOWN}
        return own if self.distribution is None else {**own, "distribution": self.distribution.name}

    def eval_pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool = True
    ) -> tuple[mi.Spectrum, mi.Float]:
        raise NotImplementedError

    def eval(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool = True
    ) -> mi.Spectrum:
        return self.eval_pdf(ctx, si, wo, active)[0]

    def pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool = True
    ) -> mi.Float:
        return self.eval_pdf(ctx, si, wo, active)[1]

    def traverse(self, callback: mi.TraversalCallback) -> None:
        expose(callback, **self.parameters())

    def to_string(self) -> str:
        return describe(self, **self.parameters(), **self.settings())
