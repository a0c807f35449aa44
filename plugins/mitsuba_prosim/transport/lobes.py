"""The lobes of a surface with a ray of their own: reflected, refracted and diffuse (section 4.1); as BSDF contexts."""

from __future__ import annotations

import functools
import operator
from typing import TypeAlias

import mitsuba as mi

#: The numbers that sample a lobe: one in [0, 1) that chooses among several, and a point in [0, 1)² for the direction.
LobePoint: TypeAlias = "tuple[mi.Float, mi.Point2f]"

#: Names of the ``mi.BSDFFlags`` of the specular reflection, glossy or ideal.
REFLECTED = ("GlossyReflection", "DeltaReflection")
#: Those of the specular transmission, glossy or ideal, and of null lobes.
REFRACTED = ("GlossyTransmission", "DeltaTransmission", "Null")
#: Those of the diffuse reflection and transmission.
DIFFUSE = ("DiffuseReflection", "DiffuseTransmission")
#: Those of the glossy lobes.
GLOSSY = ("GlossyReflection", "GlossyTransmission")
#: Those of the lobes of one direction.
IDEAL = ("DeltaReflection", "DeltaTransmission", "Null")
#: Those of the lobes of more than one.
SMOOTH = GLOSSY + DIFFUSE
#: Those of the smooth lobes that light from behind reaches.
BOTH_SIDES = ("GlossyTransmission", "DiffuseTransmission")


def all_lobes(mode: mi.TransportMode | None = None) -> mi.BSDFContext:
    """The context of all lobes; of radiance unless ``mode`` says otherwise."""
    return mi.BSDFContext() if mode is None else mi.BSDFContext(mode)


def reflected() -> mi.BSDFContext:
    """The context of the specular reflection."""
    return _context(mask(*REFLECTED))


def refracted() -> mi.BSDFContext:
    """The context of the specular transmission, null lobes included."""
    return _context(mask(*REFRACTED))


def specular() -> mi.BSDFContext:
    """The context of the specular reflection and transmission, null lobes included."""
    return _context(mask(*REFLECTED, *REFRACTED))


def diffuse() -> mi.BSDFContext:
    """The context of the diffuse reflection and transmission."""
    return _context(mask(*DIFFUSE))


def glossy(flags: int, tree: bool) -> tuple[mi.BSDFContext, ...]:
    """The contexts of the lobes with a ray of their own that may be glossy on surfaces with these ``flags``: in a
    ``tree`` of rays the reflected and the refracted one, else both as one.
    """
    if not tree:
        return (specular(),) if has_any(flags, *GLOSSY) else ()
    return tuple(lobe for name, lobe in zip(GLOSSY, (reflected(), refracted())) if has_any(flags, name))


def only(context: mi.BSDFContext, *names: str) -> mi.BSDFContext:
    """``context`` restricted to the named lobes."""
    return _context(context.type_mask & mask(*names), context.mode)


def with_null_lobes(context: mi.BSDFContext) -> mi.BSDFContext:
    """``context`` with null lobes."""
    return _context(context.type_mask | mask("Null"), context.mode)


def _context(type_mask: int, mode: mi.TransportMode | None = None) -> mi.BSDFContext:
    context = all_lobes(mode)
    context.type_mask = type_mask
    return context


@functools.cache
def mask(*names: str) -> int:
    """The named ``mi.BSDFFlags``, as one integer."""
    return functools.reduce(operator.or_, (int(getattr(mi.BSDFFlags, name)) for name in names))


def has_any(flags: int | mi.UInt32, *names: str) -> mi.Bool:
    """Whether the BSDF flags ``flags`` (an integer or a Dr.Jit array) hold one of the named ``mi.BSDFFlags``."""
    return (flags & mask(*names)) != 0


def is_all_lobes(context: mi.BSDFContext) -> bool:
    """Whether ``context`` asks for all lobes."""
    return context.type_mask == mi.BSDFContext().type_mask
