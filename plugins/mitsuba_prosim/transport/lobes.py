"""The lobes of a surface that are followed apart: the reflected, the refracted and the diffuse one (section 4.1)."""

import functools
import operator

import mitsuba as mi


def reflected():
    """``mi.BSDFContext`` of the specular reflection, glossy or ideal."""
    return _context("GlossyReflection", "DeltaReflection")


def refracted():
    """``mi.BSDFContext`` of the specular transmission, glossy or ideal, and of what passes straight through."""
    return _context("GlossyTransmission", "DeltaTransmission", "Null")


def specular():
    """``mi.BSDFContext`` of both together."""
    context = reflected()
    context.type_mask |= refracted().type_mask
    return context


def diffuse():
    """``mi.BSDFContext`` of the diffuse reflection and transmission."""
    return _context("DiffuseReflection", "DiffuseTransmission")


def _context(*flags):
    context = mi.BSDFContext()
    context.type_mask = mask(*flags)
    return context


def mask(*names):
    """The named ``mi.BSDFFlags``, as one integer."""
    return functools.reduce(operator.or_, (int(getattr(mi.BSDFFlags, name)) for name in names))


def has_any(flags, *names):
    """Whether the BSDF flags ``flags`` (an integer or a Dr.Jit array) hold one of the named ``mi.BSDFFlags``."""
    return (flags & mask(*names)) != 0
