"""Tests whether a plugin of Mitsuba is right.

The functions take the name of a type, a dictionary, XML text or an XML file, and return a :class:`.Report`::

    import mitsuba_prosim.check as check

    mi.set_variant("llvm_ad_rgb")
    check.bsdf({"type": "roughplastic", "alpha": 0.2}).raise_if_wrong()

They test in the active variant, and then compare the other variants, which are active meanwhile.
"""

from __future__ import annotations

from functools import partial

from .report import Report, Result, WrongPluginError
from .run import check, check_apart
from .subject import KINDS

__all__ = ["KINDS", "Report", "Result", "WrongPluginError", "check", "check_apart"]

bsdf, emitter, texture, phase, shape, sampler, sensor, integrator, medium, film, rfilter = (
    partial(check, kind=kind) for kind in KINDS
)
