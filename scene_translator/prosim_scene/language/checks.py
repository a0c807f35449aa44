"""What a material lacks, and which parameters of lights and materials have no effect."""

import functools

from ..model import GREY, Surface
from .diagnostics import listing
from .words import WORDS, canonical

#: What messages call a material.
CALLED = {
    "conductor": canonical("CONDUCTOR"),
    "dielectric": canonical("DIELECTRIC"),
    "lambertian": canonical("MATERIAL_KIND", "lambertian"),
    "composite": canonical("MATERIAL_KIND", "composite"),
    "phong": "surface without a material",
}


def wrong(surface: Surface) -> tuple[str, ...]:
    """What is wrong with a material, and the name of the value that is; nothing where it is right."""
    kind = surface.material
    if kind == "conductor":
        if surface.metal and (surface.eta or surface.k):
            return "a metal's name and n-refr or k-abs are given; expected one of the two", "metal"
        if not surface.metal and not (surface.eta and surface.k):
            return ("a condutor lacks its optics; expected n-refr and k-abs, or a metal's name",)
    elif kind == "dielectric":
        if surface.glass and (surface.eta or surface.abbe):
            return "a glass's name and n-refr or abbe are given; expected one of the two", "glass"
        if not surface.glass and not surface.eta:
            return ("a dieletrico lacks its index; expected n-refr, or a glass's name after dieletrico",)
    elif kind == "composite" and not surface.eta:
        return ("a composto lacks its index; expected n-refr",)
    elif kind == "composite" and surface.ks and max(map(sum, zip(surface.kd or GREY, surface.ks))) > 1 + 1e-6:
        return ("kd + ks is above 1 in a composto; expected s + d = 1 at most",)
    return ()


@functools.cache
def light_effects(distribution: str) -> list[tuple[str, str]]:
    """The parameters that a light does not know: their names, and what to say after them."""
    return [
        (name, f"has no effect on a {distribution.upper()} light; it is for a {listing(map(str.upper, kinds))}")
        for name, kinds in _unknown(distribution, "LIGHT_PARAMETER")
    ]


@functools.cache
def surface_effects(material: str | None, absorbs: bool) -> list[tuple[str, str]]:
    """The parameters that a material does not know: their names, and what to say after them."""
    kind = material or "phong"
    result = [
        (name, f"has no effect on a {CALLED[kind]}; it is for a {listing(CALLED[kind] for kind in kinds)}")
        for name, kinds in _unknown(kind, "OPTIC", "METAL")
    ]
    if kind == "dielectric" and not absorbs:
        reason = "has no effect without transmitancia, which is what that thickness lets through"
        result.append(("thickness", reason))
    return result


def _unknown(kind: str, *roles: str) -> list[tuple[str, tuple[str, ...]]]:
    """The parameters of some roles that a kind does not know: their names, and the kinds that do."""
    of = {word.name: word.of for word in WORDS if word.of and word.role in roles}
    return [(name, kinds) for name, kinds in of.items() if kind not in kinds]
