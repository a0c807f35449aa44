"""Translates a SURFACE to a BSDF of this project's plugins; computes properties of a SURFACE for both targets."""

import math
from dataclasses import dataclass

from ..language.words import INDICES, numbers_of
from ..model import GREY, Leaf, Surface, Texture, Vector
from ..nodes import Node, rgb
from . import textures
from .translation_context import Context

BLACK = (0.0, 0.0, 0.0)
#: The smallest absorption of a channel, relative to the largest. Mitsuba's ``volpath`` returns NaN for no absorption.
MIN_ABSORPTION = 1e-7


@dataclass(frozen=True)
class MediumInterface:
    """The media on the two sides of a face; each medium is the index of a SURFACE.

    ``inside`` is the index of the face's own SURFACE if this is opaque, else the index of the inner medium. ``outside``
    is None if the outer medium is air.
    """

    inside: int
    outside: int | None = None


def roughness_parameters(surface: Surface) -> Node:
    """Returns the parameters of a BSDF for the roughness of a surface; a smooth surface has none."""
    if surface.exponent is not None:
        return {"distribution": "phong", "exponent": surface.exponent}
    if surface.slope:
        return {"distribution": "beckmann", "alpha": surface.slope}
    return {}


def reflectances(surface: Surface) -> tuple[Vector, Vector, Vector]:
    """Returns kd, ks and ka of a surface; missing values have the defaults of the material."""
    kd = surface.kd or GREY
    ks = surface.ks or ((1 - kd[0], 1 - kd[1], 1 - kd[2]) if surface.material == "composite" else BLACK)
    ka = surface.ka
    if ka is None:
        ka = BLACK if surface.material in ("conductor", "dielectric") else kd
    return kd, ks, ka


def effective_textures(leaf: Leaf, surface: Surface) -> tuple[Texture | None, Texture | None]:
    """Returns the two textures of a primitive; both are None if its material ignores textures."""
    return leaf.textures if surface.material not in ("conductor", "dielectric") else (None, None)


def mean_index(context: Context, index: int | None) -> float:
    """Returns the index of refraction of the medium inside SURFACE ``index``, or of the air if ``index`` is None.

    The result is the mean of the channels r, g and b; different channels cause a warning.
    """
    if index is None:
        return context.scene.air_index
    surface = context.scene.surfaces[index]
    if surface.glass:
        return INDICES[surface.glass]
    assert surface.eta is not None
    if len(set(surface.eta)) > 1:
        reason = "n-refr differs between channels: its mean is used, without dispersion; "
        context.approximate(f"{reason}for dispersion use abbe, or a glass's name", "surfaces", index)
    return sum(surface.eta) / 3


def mean_indices(context: Context, sides: MediumInterface) -> Node:
    """Returns a BSDF's parameters for the indices of refraction on both sides of a face: one number for each side."""
    return {"int_ior": mean_index(context, sides.inside), "ext_ior": mean_index(context, sides.outside)}


def bsdf(context: Context, number: int, leaf: Leaf, sides: MediumInterface) -> Node:
    """Returns the BSDF, for this project's plugins, of a primitive: ``leaf``, node ``number`` of the CSG tree."""
    surface = context.scene.surfaces[leaf.index]
    (kd, ks, ka), rough = reflectances(surface), roughness_parameters(surface)

    def textured(color: Vector) -> Node:
        """Returns a colour that is multiplied by the textures of the primitive."""
        return textures.reflectance(context, number, leaf, effective_textures(leaf, surface), color)

    if surface.material == "conductor":
        node: Node = {"type": "prosim_conductor", "ext_ior": mean_index(context, sides.outside), **rough}
        if surface.metal:
            node["material"] = surface.metal
        elif surface.eta and surface.k:
            node |= {"eta": rgb(surface.eta), "k": rgb(surface.k)}
    elif surface.material == "dielectric":
        inside, outside = _refraction(context, sides.inside), _refraction(context, sides.outside)
        node = {"type": "prosim_dielectric"} | {f"int_{name}": value for name, value in inside.items()}
        node |= {f"ext_{name}": value for name, value in outside.items()}
        node |= rough if inside != outside else {}  # the roughness of a face between equal media has no effect
    elif surface.material == "lambertian":
        node = {"type": "prosim_lambertian", "reflectance": textured(kd)}
    elif surface.material == "composite":
        node = {
            "type": "prosim_composite",
            "diffuse_reflectance": textured(kd),
            "specular_reflectance": rgb(ks),
            **mean_indices(context, sides),
            **rough,
        }
    else:
        node = {"type": "prosim_phong", "diffuse_reflectance": textured(kd), "specular_reflectance": rgb(ks)}
        if (exponent := phong_exponent(surface)) is not None:
            node["exponent"] = exponent
    # The parameter is left out if it has the plugin's default: kd for lambertiano and composto, else black.
    if any(ka) if surface.material not in ("lambertian", "composite") else surface.ka is not None:
        node["ambient"] = textured(ka)
    return node


def _refraction(context: Context, index: int | None) -> Node:
    """Returns the refraction of the medium inside SURFACE ``index``, or of the air if ``index`` is None.

    The keys of the result are parameters of a BSDF without their prefix, which is "int_" for the inner side of a face
    and "ext_" for the outer side.
    """
    surface = Surface() if index is None else context.scene.surfaces[index]
    if surface.glass:
        return {"material": surface.glass}
    dispersion = {} if surface.abbe is None else {"abbe": float(surface.abbe)}
    return {"ior": mean_index(context, index), **dispersion}


def absorbs(surface: Surface) -> bool:
    """Whether the medium inside a surface absorbs light."""
    return surface.material == "dielectric" and min(surface.transmittance or (1.0,)) < 1


def media(context: Context, sides: MediumInterface) -> Node:
    """Returns the absorbing media on both sides of a face, as parameters of the shape."""
    sides_by_name = {"interior": sides.inside, "exterior": sides.outside}
    surfaces = {name: context.scene.surfaces[i] for name, i in sides_by_name.items() if i is not None}
    return {name: _absorbing_medium(surface) for name, surface in surfaces.items() if absorbs(surface)}


def _absorbing_medium(surface: Surface) -> Node:
    """Returns the absorbing medium inside a surface.

    By Beer's law, the transmittance T over the thickness d is exp(-s d). Mitsuba's colours are at most 1, so the
    absorption s is divided by ``scale``.
    """
    assert surface.transmittance is not None
    sigma = [-math.log(t) / surface.thickness for t in surface.transmittance]
    scale = max(sigma)
    relative = rgb(max(channel / scale, MIN_ABSORPTION) for channel in sigma)
    return {"type": "homogeneous", "albedo": 0.0, "sigma_t": relative, "scale": scale}


def phong_exponent(surface: Surface) -> float | None:
    """Returns the exponent of a surface's Phong lobe, or None for a mirror.

    An exponent in the scene is returned as it is. An RMS slope m is converted to n = 2/m^2 - 2, limited to the range of
    the scene language. Walter et al. (2007) give this formula for the angle to the half vector. Here n is used for the
    angle to the mirror direction, so the lobe is about half as wide as Beckmann's.
    """
    if surface.exponent is None and surface.slope:
        return min(max(2 / surface.slope**2 - 2, 0.0), numbers_of("OPTIC", "exponent").high)
    return surface.exponent


def beckmann_slope(surface: Surface) -> float:
    """Returns the RMS slope m of Beckmann's distribution for a surface, or 0 if the surface is smooth.

    A Phong exponent n is converted to m = sqrt(2/(n + 2)), the inverse of the formula of :func:`phong_exponent`.
    """
    if surface.exponent is not None:
        return math.sqrt(2 / (surface.exponent + 2))
    return surface.slope or 0.0
