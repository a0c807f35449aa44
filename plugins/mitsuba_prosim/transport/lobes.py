"""BSDF contexts that select lobes of a surface: the reflected, the refracted and the diffuse lobe (thesis, section
4.1).
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence
from typing import TypeAlias

import mitsuba as mi

#: The random numbers that sample a lobe: a number in [0, 1) chooses one of several lobes, and a point in [0, 1)²
#: chooses the direction.
LobePoint: TypeAlias = "tuple[mi.Float, mi.Point2f]"

#: BSDF contexts that each select some lobes.
Lobes: TypeAlias = "tuple[mi.BSDFContext, ...]"

#: Names of the ``mi.BSDFFlags`` of the specular reflection, glossy or ideal.
REFLECTED = ("GlossyReflection", "DeltaReflection")
#: Names of the ``mi.BSDFFlags`` of the specular transmission, glossy or ideal, alone and with null lobes.
THROUGH = ("GlossyTransmission", "DeltaTransmission")
REFRACTED = (*THROUGH, "Null")
#: Names of the ``mi.BSDFFlags`` of the specular reflection and transmission, and of null lobes.
SPECULAR = REFLECTED + REFRACTED
#: Names of the ``mi.BSDFFlags`` of the diffuse reflection and transmission.
DIFFUSE = ("DiffuseReflection", "DiffuseTransmission")
#: Names of the ``mi.BSDFFlags`` of the glossy lobes.
GLOSSY = ("GlossyReflection", "GlossyTransmission")
#: Names of the ``mi.BSDFFlags`` of the lobes that scatter into a single direction.
IDEAL = ("DeltaReflection", "DeltaTransmission", "Null")
#: Names of the ``mi.BSDFFlags`` of the lobes that scatter into more than one direction.
SMOOTH = GLOSSY + DIFFUSE
#: Names of the ``mi.BSDFFlags`` of the smooth lobes that scatter light from behind the surface, and of the others.
BOTH_SIDES = ("GlossyTransmission", "DiffuseTransmission")
ONE_SIDE = ("GlossyReflection", "DiffuseReflection")


def only(names: Sequence[str], context: mi.BSDFContext | None = None) -> mi.BSDFContext:
    """Returns the BSDF ``context`` (default: all lobes), restricted to the lobes with these ``names``."""
    context = context or mi.BSDFContext()
    return mi.BSDFContext(context.mode, context.type_mask & mask(*names), context.component)


def glossy(flags: int, tree: bool) -> Lobes:
    """Returns the BSDF contexts of the specular lobes that may be glossy on surfaces with these BSDF ``flags``: in a
    ray ``tree``, which samples a ray of each, one for reflection and one for transmission; on a path, one for both.
    """
    if not tree:
        return (only(SPECULAR),) if has_any(flags, *GLOSSY) else ()
    return tuple(lobe for name, lobe in zip(GLOSSY, (only(REFLECTED), only(REFRACTED))) if has_any(flags, name))


@functools.cache
def mask(*names: str) -> int:
    """Combines the named ``mi.BSDFFlags`` into one integer."""
    return functools.reduce(operator.or_, (int(getattr(mi.BSDFFlags, name)) for name in names))


def has_any(flags: int | mi.UInt32, *names: str) -> mi.Bool:
    """Tells whether ``flags``, an integer or a Dr.Jit array, contain one of the ``mi.BSDFFlags`` ``names``."""
    return (flags & mask(*names)) != 0
