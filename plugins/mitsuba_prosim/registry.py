"""Registers the plugins with Mitsuba, for the active variant.

A plugin class derives from a class of one variant (``mi.BSDF`` of ``llvm_ad_rgb``, for example). So a module that
defines a plugin is executed again when the variant changes; a module of functions, which use the active variant at each
call, only once.
"""

import importlib
import os
import pkgutil
import re
import sys
from collections.abc import Callable, Iterator
from typing import Any

import mitsuba as mi

from . import llvm

#: Modules of base classes. These modules depend on the variant like the plugins, and are executed first.
BASES = ("optics.material", "light.source", "procedural.mixture", "sampling.sampler", "engine.integrator")

#: The folders of plugins, in the order of the thesis: 5.1 materials, 5.2 light sources, textures, sensors, 5.3
#: sampling, 5.4 rendering.
FOLDERS = ("bsdfs", "emitters", "textures", "sensors", "samplers", "integrators")

#: Plugin name -> class for the active variant; the decorator below fills this table.
PLUGINS: dict[str, type] = {}

_registered_for: str | None = None


def plugin(kind: str, name: str) -> Callable[[type], type]:
    """Class decorator: registers the class as Mitsuba plugin ``name`` of this ``kind`` ("bsdf", "emitter", ...).

    Mitsuba 3.9 looks up the type of a plugin in the variant ``scalar_rgb``, even if another variant is active; without
    it, ``mi.load_dict`` merges equal emitters into one, and writing a scene as XML fails. So a class of another variant
    is registered for ``scalar_rgb``, too, until its own class replaces it.
    """

    def register(cls: type) -> type:
        for variant in {mi.variant(), "scalar_rgb"}:
            getattr(getattr(mi, variant), "register_" + kind)(name, cls)
        PLUGINS[name] = cls
        return cls

    return register


def parameters(name: str) -> list[str]:
    """Returns the parameters of the plugin ``name`` of this package, from its page; empty for other plugins."""
    page = PLUGINS[name].__doc__ or "" if name in PLUGINS else ""
    return re.findall(r"\w+", " ".join(re.findall(r"^ *\* - ([\w,\s]+?)\n *- \|", page, re.MULTILINE)))


def create(name: str, **properties: Any) -> Any:
    """Creates an object of the plugin ``name`` with ``properties``.

    ``mi.load_dict`` (Mitsuba 3.9) would replace the file search path of the process for a moment, so that objects of
    the scene that other threads create at this moment would read freed memory.
    """
    props = mi.Properties(name)
    for key, value in properties.items():
        props[key] = value
    return mi.PluginManager.instance().create_object(props)


def modules() -> Iterator[str]:
    """Yields the full names of the modules that are executed again for every variant; base classes come first."""
    yield from (f"{__package__}.{module}" for module in BASES)
    for folder in FOLDERS:
        path = os.path.join(os.path.dirname(__file__), folder)  # pathlib would be slow to import
        yield from (f"{__package__}.{folder}.{module.name}" for module in pkgutil.iter_modules([path]))


def register_plugins(*_: object) -> None:
    """Registers all plugins for the active variant; does nothing if there is no variant, or they are registered.

    Mitsuba calls this function after each change of the variant; the arguments (old variant, new variant) are ignored.
    Raises RuntimeError if LLVM would abort the process (see ``llvm.problem``). After an error, the next call tries
    again.
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
