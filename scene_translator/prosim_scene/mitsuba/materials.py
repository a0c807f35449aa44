"""SURFACE -> BSDF of this project's plugins, and functions of a surface for both targets."""

import math
from dataclasses import dataclass

from ..language.words import INDICES, numbers_of
from ..model import GREY, Leaf, Surface, Texture, Vector
from ..nodes import Node, rgb
from . import textures
from .translation_context import Context

BLACK = (0.0, 0.0, 0.0)
#: The least absorption of a channel, relative to the largest: ``volpath`` returns NaN for 0.
MIN_ABSORPTION = 1e-7


@dataclass(frozen=True)
class MediumInterface:
    """The media on both sides of a face, as indices of SURFACEs.

    ``inside``: the face's own SURFACE if that is opaque, else that of the inner medium. ``outside``: None for air.
    """

    inside: int
    outside: int | None = None


def roughness_parameters(surface: Surface) -> Node:
    """The parameters of a BSDF for the roughness of a surface; none for a smooth one."""
    if surface.exponent is not None:
        return {"distribution": "phong", "exponent": surface.exponent}
    if surface.slope:
        return {"distribution": "beckmann", "alpha": surface.slope}
    return {}


def reflectances(surface: Surface) -> tuple[Vector, Vector, Vector]:
    """kd, ks and ka of a surface, with the defaults of its material."""
    kd = surface.kd or GREY
    ks = surface.ks or ((1 - kd[0], 1 - kd[1], 1 - kd[2]) if surface.material == "composite" else BLACK)
    ka = surface.ka
    if ka is None:
        ka = BLACK if surface.material in ("conductor", "dielectric") else kd
    return kd, ks, ka


def effective_textures(leaf: Leaf, surface: Surface) -> tuple[Texture | None, Texture | None]:
    """The textures of a leaf, without those that its material ignores."""
    return leaf.textures if surface.material not in ("conductor", "dielectric") else (None, None)


def mean_index(context: Context, index: int, surface: Surface) -> float:
    """The index of refraction as one number: the mean of the channels, with a warning if they differ."""
    if surface.glass:
        return INDICES[surface.glass]
    assert surface.eta is not None
    if len(set(surface.eta)) > 1:
        reason = "n-refr differs between channels: its mean is used, without dispersion; "
        context.approximate(f"{reason}for dispersion use abbe, or a glass's name", "surfaces", index)
    return sum(surface.eta) / 3


def refraction_indices(context: Context, sides: MediumInterface) -> Node:
    """The parameters for the indices of refraction on both sides of a dielectric's face, with dispersion."""
    inside, outside = _index_parameters(context, sides.inside, "int"), {"ext_ior": context.scene.air_index}
    return inside | (outside if sides.outside is None else _index_parameters(context, sides.outside, "ext"))


def mean_indices(context: Context, sides: MediumInterface) -> Node:
    """The parameters for the indices of refraction on both sides, one number each."""
    inside = mean_index(context, sides.inside, context.scene.surfaces[sides.inside])
    return {"int_ior": inside, "ext_ior": outside_index(context, sides)}


def outside_index(context: Context, sides: MediumInterface) -> float:
    """The index of refraction outside of a face, as one number."""
    if sides.outside is None:
        return context.scene.air_index
    return mean_index(context, sides.outside, context.scene.surfaces[sides.outside])


def has_equal_indices(indices: Node) -> bool:
    """Whether a face has the same index on both sides; then roughness has no effect."""
    inside, outside = ({k[4:]: v for k, v in indices.items() if k.startswith(side)} for side in ("int", "ext"))
    return inside == outside


def bsdf(context: Context, number: int, leaf: Leaf, sides: MediumInterface) -> Node:
    """The BSDF (this project's plugins) of a primitive: ``leaf``, node ``number`` of the CSG tree."""
    surface = context.scene.surfaces[leaf.index]
    (kd, ks, ka), rough = reflectances(surface), roughness_parameters(surface)

    def textured(color: Vector) -> Node:
        """A colour with the textures of the leaf."""
        return textures.reflectance(context, number, leaf, effective_textures(leaf, surface), color)

    if surface.material == "conductor":
        node: Node = {"type": "prosim_conductor", "ext_ior": outside_index(context, sides), **rough}
        if surface.metal:
            node["material"] = surface.metal
        elif surface.eta and surface.k:
            node |= {"eta": rgb(surface.eta), "k": rgb(surface.k)}
    elif surface.material == "dielectric":
        node = {"type": "prosim_dielectric", **(both := refraction_indices(context, sides))}
        node |= {} if has_equal_indices(both) else rough
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
    if any(ka) if surface.material not in ("lambertian", "composite") else surface.ka is not None:
        node["ambient"] = textured(ka)
    return node


def _index_parameters(context: Context, index: int, side: str) -> Node:
    """The parameters for the refraction of the medium inside SURFACE ``index``; ``side``: "int" or "ext"."""
    surface = context.scene.surfaces[index]
    if surface.glass:
        return {f"{side}_material": surface.glass}
    dispersion = {} if surface.abbe is None else {f"{side}_abbe": float(surface.abbe)}
    return {f"{side}_ior": mean_index(context, index, surface), **dispersion}


def absorbs(surface: Surface) -> bool:
    """Whether a surface encloses an absorbing medium."""
    return surface.material == "dielectric" and min(surface.transmittance or (1.0,)) < 1


def media(context: Context, sides: MediumInterface) -> Node:
    """The absorbing media on both sides of a face, as parameters of its shape."""
    result = {"interior": _absorbing_medium(context.scene.surfaces[sides.inside])}
    if sides.outside is not None:
        result["exterior"] = _absorbing_medium(context.scene.surfaces[sides.outside])
    return {name: medium for name, medium in result.items() if medium}


def _absorbing_medium(surface: Surface) -> Node:
    """The absorbing medium inside a surface; empty for a clear one.

    By Beer's law the transmittance T over the thickness d is exp(-s d). Mitsuba's colours are at most 1, hence the
    scale.
    """
    if not absorbs(surface):
        return {}
    assert surface.transmittance is not None
    sigma = [-math.log(t) / surface.thickness for t in surface.transmittance]
    scale = max(sigma)
    shares = rgb(max(s / scale, MIN_ABSORPTION) for s in sigma)
    return {"type": "homogeneous", "albedo": 0.0, "sigma_t": shares, "scale": scale}


def phong_exponent(surface: Surface) -> float | None:
    """Exponent of the Phong lobe, None for a mirror; an RMS slope m is converted by n = 2/m^2 - 2 (Walter et al. 2007).

    The result is at most the largest exponent of the language.
    """
    if surface.exponent is None and surface.slope:
        return min(max(2 / surface.slope**2 - 2, 0.0), numbers_of("OPTIC", "exponent").high)
    return surface.exponent


def beckmann_slope(surface: Surface) -> float:
    """Beckmann's RMS slope: m itself, or that of a Phong exponent n (n = 2/m^2 - 2); 0: smooth."""
    if surface.exponent is not None:
        return math.sqrt(2 / (surface.exponent + 2))
    return surface.slope or 0.0
