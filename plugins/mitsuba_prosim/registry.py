"""Registration of the plugins into Mitsuba, for whatever variant is active.

A Mitsuba plugin class derives from a class of one variant (``mi.BSDF`` of ``llvm_ad_rgb``, say), so a module that
defines one has to run again when the variant changes: Mitsuba does the same with its own Python integrators. Modules
that hold pure functions look ``mi`` up when they are called and need no second run.
"""

from __future__ import annotations

import importlib
import pkgutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mitsuba as mi

from . import llvm

#: Modules of base classes that several plugins share; they depend on the variant as well, and run first.
BASES = ("optics.pigmented", "procedural.mixture", "sampling.sampler", "engine.integrator")

#: The folders of plugins, one a module. In the order of the thesis: 5.1 materials, 5.2 sources, textures, views, 5.3
#: sampling, 5.4 rendering.
FOLDERS = ("bsdfs", "emitters", "textures", "sensors", "samplers", "integrators")

#: Plugin name -> class, filled by the decorator below for the active variant.
PLUGINS: dict[str, type] = {}

_registered_for: str | None = None


def plugin(kind: str, name: str) -> Callable[[type], type]:
    """Class decorator: registers the class as Mitsuba plugin ``name`` of the given ``kind`` ("bsdf", "emitter", ...).

    Mitsuba 3.9 asks for the type of a plugin under ``scalar_rgb``, whatever variant is active (``load_dict`` would
    merge two equal emitters, and writing XML would fail, if the name were unknown there); so the name is made known
    to that variant too. Only its type is asked for: the real class takes over when ``scalar_rgb`` becomes active.
    """

    def register(cls: type) -> type:
        for variant in {mi.variant(), "scalar_rgb"}:
            getattr(getattr(mi, variant), "register_" + kind)(name, cls)
        PLUGINS[name] = cls
        return cls

    return register


def create(name: str, **properties: Any) -> Any:
    """An object of the plugin ``name``, with ``properties`` as ``mi.Properties`` takes them.

    For plugins that need another one. ``mi.load_dict`` won't do there: while it works it puts another file resolver in
    the place of the process's own (Mitsuba 3.9), which must not happen while Mitsuba makes the other objects of the
    scene in its threads; those that look for a file at that moment read memory that has been freed.
    """
    props = mi.Properties(name)
    for key, value in properties.items():
        props[key] = value
    return mi.PluginManager.instance().create_object(props)


def modules() -> Iterator[str]:
    """Full names of the modules that run anew for every variant, base classes first."""
    yield from (f"{__package__}.{module}" for module in BASES)
    for folder in FOLDERS:
        path = Path(__file__).with_name(folder)
        yield from (f"{__package__}.{folder}.{module.name}" for module in pkgutil.iter_modules([str(path)]))


def register_plugins(*_: object) -> None:
    """Registers all plugins for the active variant; does nothing while none is set, or when that is done already.

    Serves as Mitsuba's variant callback, hence the ignored arguments (old variant, new variant). Raises RuntimeError
    where the variant runs on an LLVM that would abort the process (see ``llvm.problem``).
    """
    global _registered_for
    variant = mi.variant()
    if variant is None or variant == _registered_for:
        return
    if variant.startswith("llvm_") and (problem := llvm.problem()):
        raise RuntimeError(problem)
    _registered_for = None
    for name in modules():
        if name in sys.modules:
            importlib.reload(sys.modules[name])
        else:
            importlib.import_module(name)
    _registered_for = variant
