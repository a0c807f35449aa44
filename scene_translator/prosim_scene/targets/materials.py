"""SURFACE -> BSDF of this project's plugins, and what both targets need of a surface."""

import math

from ..language.names import INDICES
from ..language.words import numbers
from ..model import GREY, Leaf, Surface, Texture, Vector
from ..nodes import Node, rgb
from . import textures
from .context import Context

BLACK = (0.0, 0.0, 0.0)
#: The least absorption of a channel, as a share of the largest: ``volpath`` gives no number where there is none.
LEAST = 1e-7


def roughness(surface: Surface) -> Node:
    """The parameters of a rough surface."""
    if surface.exponent is not None:
        return {"distribution": "phong", "exponent": surface.exponent}
    if surface.slope:
        return {"distribution": "beckmann", "alpha": surface.slope}
    return {}


def defaults(surface: Surface) -> tuple[Vector, Vector, Vector]:
    """kd, ks and ka of a surface, with the defaults of its material."""
    kd = surface.kd or GREY
    ks = surface.ks or ((1 - kd[0], 1 - kd[1], 1 - kd[2]) if surface.material == "composite" else BLACK)
    ka = surface.ka
    if ka is None:
        ka = BLACK if surface.material in ("conductor", "dielectric") else kd
    return kd, ks, ka


def slots(leaf: Leaf, surface: Surface) -> tuple[Texture | None, Texture | None]:
    """The textures that have an effect on a leaf."""
    return leaf.textures if surface.material not in ("conductor", "dielectric") else (None, None)


def mean_index(context: Context, index: int, surface: Surface) -> float:
    """The index of refraction as one number; per-channel ones are averaged, and said so."""
    if surface.glass:
        return INDICES[surface.glass]
    assert surface.eta is not None
    if len(set(surface.eta)) > 1:
        context.approximate(
            "the index of refraction differs from channel to channel: its mean is used, without dispersion "
            "(a dieletrico disperses by abbe, or a glass's name)",
            "surfaces",
            index,
        )
    return sum(surface.eta) / 3


def bsdf(context: Context, number: int, leaf: Leaf) -> Node:
    """The BSDF of this project's plugins for a leaf, node ``number`` of the tree."""
    surface = context.scene.surfaces[leaf.index]
    kd, ks, ka = defaults(surface)

    def textured(color: Vector) -> Node:
        return textures.reflectance(context, number, leaf, slots(leaf, surface), color)

    air = context.scene.air_index
    if surface.material == "conductor":
        node: Node = {"type": "prosim_conductor", "ext_ior": air, **roughness(surface)}
        if surface.metal:
            node["material"] = surface.metal
        elif surface.eta and surface.k:
            node |= {"eta": rgb(surface.eta), "k": rgb(surface.k)}
    elif surface.material == "dielectric":
        node = {
            "type": "prosim_dielectric",
            **_index(context, leaf.index, surface),
            "ext_ior": air,
            **roughness(surface),
        }
    elif surface.material == "lambertian":
        node = {"type": "prosim_lambertian", "reflectance": textured(kd)}
    elif surface.material == "composite":
        node = {
            "type": "prosim_composite",
            "diffuse_reflectance": textured(kd),
            "specular_reflectance": rgb(ks),
            "int_ior": mean_index(context, leaf.index, surface),
            "ext_ior": air,
            **roughness(surface),
        }
    else:
        node = {"type": "prosim_phong", "diffuse_reflectance": textured(kd), "specular_reflectance": rgb(ks)}
        if (exponent := phong_exponent(surface)) is not None:
            node["exponent"] = exponent
    if any(ka) if surface.material not in ("lambertian", "composite") else surface.ka is not None:
        node["ambient"] = textured(ka)
    return node


def _index(context: Context, index: int, surface: Surface) -> Node:
    """The parameters of the index of a dielectric: a number, or what depends on the wavelength."""
    if surface.glass:
        return {"int_material": surface.glass}
    dispersion = {} if surface.abbe is None else {"int_abbe": float(surface.abbe)}
    return {"int_ior": mean_index(context, index, surface), **dispersion}


def absorbs(surface: Surface) -> bool:
    """Whether light is absorbed inside."""
    return surface.material == "dielectric" and min(surface.transmittance or (1.0,)) < 1


def interior(surface: Surface) -> Node:
    """What lies inside a dielectric that absorbs, as a parameter of its shapes; nothing for others.

    By Beer's law the transmittance T over the thickness d is exp(-s d). Mitsuba's colours are at most 1, hence the
    scale.
    """
    if not absorbs(surface):
        return {}
    assert surface.transmittance is not None
    sigma = [-math.log(t) / surface.thickness for t in surface.transmittance]
    scale = max(sigma)
    shares = rgb(max(s / scale, LEAST) for s in sigma)
    return {"interior": {"type": "homogeneous", "albedo": 0.0, "sigma_t": shares, "scale": scale}}


def phong_exponent(surface: Surface) -> float | None:
    """Exponent of the Phong lobe, None for a mirror; an RMS slope m is converted by n = 2/m^2 - 2 (Walter et al. 2007).

    The largest is that of the language.
    """
    if surface.exponent is None and surface.slope:
        return min(max(2 / surface.slope**2 - 2, 0.0), numbers("OPTIC", "exponent").high)
    return surface.exponent


def beckmann_slope(surface: Surface) -> float:
    """Beckmann's RMS slope: m itself, or that of a Phong exponent n (n = 2/m^2 - 2); 0: smooth."""
    if surface.exponent is not None:
        return math.sqrt(2 / (surface.exponent + 2))
    return surface.slope or 0.0
