"""Stochastic ray tracing after Besuievsky (1992), as plugins of Mitsuba 3.

Importing this package registers its plugins at once if a Mitsuba variant is set, and whenever the variant changes::

    import mitsuba as mi
    import mitsuba_prosim

    mi.set_variant("llvm_ad_rgb")

Mitsuba 3.10 and later find this package automatically through the entry-point group ``mitsuba``.
"""

from typing import Any

import mitsuba as mi

from .registry import register_plugins

__all__ = ["denoise", "explain", "register_plugins", "show"]

__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """Imports the function ``denoise``, ``explain`` or ``show`` of this package when it is first used, and returns it.

    Raises AttributeError for other names.
    """
    if name == "denoise":
        from .denoising import denoise

        return denoise
    if name == "explain":
        from .explaining.explanation import explain

        return explain
    if name == "show":
        from .live.notebook import show

        return show
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


mi.detail.add_variant_callback(register_plugins)
register_plugins()
