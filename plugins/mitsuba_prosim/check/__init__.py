"""Tests whether a plugin of Mitsuba is right.

The function takes the name of a type, a dictionary or an XML file, and returns a :class:`.Report`::

    from mitsuba_prosim.check import check

    mi.set_variant("llvm_ad_rgb")
    check({"type": "roughplastic", "alpha": 0.2}).raise_if_wrong()

It tests in the active variant, and then compares the other variants, which are active meanwhile.
"""

from .report import Report, Result, WrongPluginError
from .run import check, check_apart
from .subject import KINDS

__all__ = ["KINDS", "Report", "Result", "WrongPluginError", "check", "check_apart"]
