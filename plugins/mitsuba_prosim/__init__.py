"""Stochastic ray tracing after Besuievsky (1992), as plugins of Mitsuba 3.

Importing this package registers its plugins at once if a Mitsuba variant is set, and whenever the variant changes::

    import mitsuba as mi
    import mitsuba_prosim

    mi.set_variant("llvm_ad_rgb")

Mitsuba 3.10 and later find this package automatically through the entry-point group ``mitsuba``.
"""

from importlib import import_module
from typing import Any

import mitsuba as mi

from .registry import register_plugins

__all__ = ["denoise", "explain", "register_plugins", "render", "show"]

__version__ = "0.2.0"

#: Functions of this package that are imported when they are first used -> their modules.
LAZY = {"denoise": "denoising", "explain": "explaining.explanation", "render": "live.result", "show": "live.result"}


def __getattr__(name: str) -> Any:
    """Imports a function of this package, one of :data:`LAZY`. Raises AttributeError for other names."""
    if name in LAZY:
        return getattr(import_module(f"{__name__}.{LAZY[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


mi.detail.add_variant_callback(register_plugins)
register_plugins()
