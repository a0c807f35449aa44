"""The lobes of a surface that are followed apart: the reflected, the refracted and the diffuse one (section 4.1)."""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence

import mitsuba as mi

#: Names of the ``mi.BSDFFlags`` of the specular reflection, glossy or ideal.
REFLECTED = ("GlossyReflection", "DeltaReflection")
#: Those of the specular transmission, glossy or ideal, and of what passes straight through.
REFRACTED = ("GlossyTransmission", "DeltaTransmission", "Null")
#: Those of the diffuse reflection and transmission.
DIFFUSE = ("DiffuseReflection", "DiffuseTransmission")
#: Those of the lobes of neither one direction nor all alike.
GLOSSY = ("GlossyReflection", "GlossyTransmission")
#: Those of the lobes of one direction.
IDEAL = ("DeltaReflection", "DeltaTransmission", "Null")
#: Those of the lobes of more than one.
SMOOTH = GLOSSY + DIFFUSE
#: Those of the smooth lobes that light from behind reaches.
BOTH_SIDES = ("GlossyTransmission", "DiffuseTransmission")


def everything(mode: mi.TransportMode | None = None) -> mi.BSDFContext:
    """The context of all lobes; of radiance unless ``mode`` says otherwise."""
    return mi.BSDFContext() if mode is None else mi.BSDFContext(mode)


def reflected() -> mi.BSDFContext:
    """The context of the specular reflection."""
    return _context(REFLECTED)


def refracted() -> mi.BSDFContext:
    """The context of the specular transmission, straight through included."""
    return _context(REFRACTED)


def specular() -> mi.BSDFContext:
    """The context of both together."""
    return _context(REFLECTED + REFRACTED)


def diffuse() -> mi.BSDFContext:
    """The context of the diffuse reflection and transmission."""
    return _context(DIFFUSE)


def only(context: mi.BSDFContext, *names: str) -> mi.BSDFContext:
    """``context`` for no other lobes than the named ones."""
    return _of_type(context, context.type_mask & mask(*names))


def and_through(context: mi.BSDFContext) -> mi.BSDFContext:
    """``context`` for what passes straight through as well."""
    return _of_type(context, context.type_mask | mask("Null"))


def _of_type(context: mi.BSDFContext, type_mask: int) -> mi.BSDFContext:
    other = mi.BSDFContext(context.mode)
    other.type_mask = type_mask
    return other


def _context(names: Sequence[str]) -> mi.BSDFContext:
    context = mi.BSDFContext()
    context.type_mask = mask(*names)
    return context


def mask(*names: str) -> int:
    """The named ``mi.BSDFFlags``, as one integer."""
    return functools.reduce(operator.or_, (int(getattr(mi.BSDFFlags, name)) for name in names))


def has_any(flags: int | mi.UInt32, *names: str) -> mi.Bool:
    """Whether the BSDF flags ``flags`` (an integer or a Dr.Jit array) hold one of the named ``mi.BSDFFlags``."""
    return (flags & mask(*names)) != 0


def is_everything(context: mi.BSDFContext) -> bool:
    """Whether ``context`` asks for all lobes."""
    return context.type_mask == mi.BSDFContext().type_mask
