"""Tests whether a plugin of Mitsuba is right.

The functions take the name of a type, a dictionary, XML text or an XML file, and return a :class:`.Report`::

    import mitsuba_prosim.check as check

    mi.set_variant("llvm_ad_rgb")
    check.bsdf({"type": "roughplastic", "alpha": 0.2}).raise_if_wrong()

They test in the active variant, and then compare the other variants, which are active meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from .report import Report, Result, WrongPluginError
from .run import check, check_apart
from .subject import KINDS

__all__ = ["KINDS", "Report", "Result", "WrongPluginError", "check", "check_apart"]


def _of_kind(kind: str) -> Callable[..., Report]:
    def test(source: str | Path | Mapping[str, Any], *, node: int = 0, modules: Sequence[str] = ()) -> Report:
        return check(source, kind, node=node, modules=modules)

    test.__name__ = test.__qualname__ = kind
    test.__doc__ = f"Tests a plugin of the kind {kind} as :func:`check` does; raises TypeError for another kind."
    return test


phase, rfilter, bsdf, emitter, texture, shape, sampler, sensor, integrator, medium, film = map(_of_kind, KINDS.values())
