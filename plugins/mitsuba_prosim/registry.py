"""Registration of the plugins into Mitsuba, for whatever variant is active.

A Mitsuba plugin class derives from a class of one variant (``mi.BSDF`` of ``llvm_ad_rgb``, say), so a module that
defines one has to run again when the variant changes: Mitsuba does the same with its own Python integrators. Modules
that hold pure functions look ``mi`` up when they are called and need no second run.
"""

import importlib
import importlib.util
import sys

import mitsuba as mi

#: One plugin, one module; the order is that of the thesis (5.1 materials, 5.2 sources, textures, 5.3 sampling).
MODULES = (
    "bsdfs.conductor",
    "bsdfs.dielectric",
    "bsdfs.lambertian",
    "bsdfs.composite",
    "bsdfs.phong",
    "emitters.point",
    "emitters.area",
    "textures.brick",
    "textures.stripes",
    "textures.fractal",
    "samplers.nrook",
    "integrators.prosim",
)

#: Plugin name -> kind ("bsdf", "emitter", ...), filled by the decorator below.
PLUGINS = {}


def plugin(kind, name):
    """Class decorator: registers the class as Mitsuba plugin ``name`` of the given ``kind``.

    Mitsuba 3.9 asks for the type of a plugin under ``scalar_rgb``, whatever variant is active (``load_dict`` would
    merge two equal emitters, and writing XML would fail, if the name were unknown there); so the name is made known
    to that variant too. Only its type is asked for: the real class takes over when ``scalar_rgb`` becomes active.
    """
    def register(cls):
        for variant in {mi.variant(), "scalar_rgb"}:
            getattr(getattr(mi, variant), "register_" + kind)(name, cls)
        PLUGINS[name] = kind
        return cls
    return register


def register_plugins(*_):
    """Registers all plugins for the active variant; does nothing while none is set.

    Serves as Mitsuba's variant callback, hence the ignored arguments (old variant, new variant).
    """
    if mi.variant() is None:
        return
    for name in MODULES:
        name = f"{__package__}.{name}"
        if importlib.util.find_spec(name) is None:  # not written yet
            continue
        if name in sys.modules:
            importlib.reload(sys.modules[name])
        else:
            importlib.import_module(name)
